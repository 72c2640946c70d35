// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/import_manifest.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <iterator>
#include <map>
#include <set>
#include <tuple>

#include "db/interchange/image_file.h"
#include "shared/config/toml_reader.h"

namespace stratalux::db {
namespace {

constexpr int kMostPoses = 100000;
// A few hundred bytes each; a manifest of half a megabyte can name hundreds of millions, poses times patterns.
constexpr size_t kMostFrames = 250'000;

struct Pose {
  int index = -1;
  std::string folder;
  int crop_x = 0, crop_y = 0, width = 0, height = 0;
};

struct Shot {
  std::string file, where;
  FrameRecord record;
  int pose = -1;  // this one only; -1: each
};

struct Projectors {
  int count = 1, width = 0, height = 0;
};

Status At(const TomlTable& table, const std::string& key, const std::string& message) {
  return Status::Usage(table.Where(key) + ": " + key + ": " + message);
}

CapturePhase PhaseOf(PatternKind kind) {
  switch (kind) {
    case PatternKind::kGray:
      return CapturePhase::kCorrespondence;
    case PatternKind::kCheckerboard:
    case PatternKind::kSinusoid:
      return CapturePhase::kSeparation;
    case PatternKind::kComb:
      return CapturePhase::kSweep;
    case PatternKind::kSpots:
      return CapturePhase::kSpot;
    case PatternKind::kGrey:
      return CapturePhase::kRadiometry;
    case PatternKind::kBlack:
    case PatternKind::kWhite:
      break;
  }
  return CapturePhase::kReference;
}

Result<Cfa> ParseCfa(const std::string& text) {
  constexpr std::array<const char*, 5> kNames = {"mono", "rggb", "bggr", "grbg", "gbrg"};
  for (size_t i = 0; i < kNames.size(); ++i)
    if (text == kNames[i]) return static_cast<Cfa>(i);
  return Status::Usage("'" + text + "' is unknown; allowed: mono, rggb, bggr, grbg, gbrg");
}

// Fills what all frames share. Getters remember their own complaints until Finish().
Status ReadHead(TomlTable head, ImportManifest& manifest, FrameRecord& common, Projectors& projectors) {
  std::string kind = "calibration", cfa = "mono", alignment = "high";
  int saturation_dn = 0;
  for (const char* key : {"rig", "camera_width", "camera_height", "bit_depth", "projector_width", "projector_height"})
    head.Require(key);
  head.Get("rig", manifest.info.rig);
  head.Get("visitor", manifest.info.visitor);
  head.Get("kind", kind);
  head.Get("cfa", cfa);
  head.Get("alignment", alignment);
  head.Get("camera_width", manifest.camera_width, 1, kLargestSide);
  head.Get("camera_height", manifest.camera_height, 1, kLargestSide);
  head.Get("bit_depth", manifest.bit_depth, 8, 16);
  head.Get("projectors", projectors.count, 1, 16);
  head.Get("projector_width", projectors.width, 16, 8192);
  head.Get("projector_height", projectors.height, 16, 8192);
  head.Get("exposure_ms", common.exposure_ms, 0.0, 10000.0);
  head.Get("saturation", saturation_dn, 16, 65535);
  manifest.info.devices = {manifest.camera_width, manifest.camera_height, projectors.width, projectors.height,
                           static_cast<double>(saturation_dn)};

  const auto parsed_kind = ParseSessionKind(kind);
  if (!parsed_kind.ok()) return At(head, "kind", parsed_kind.status().message());
  manifest.info.kind = *parsed_kind;
  const auto parsed_cfa = ParseCfa(cfa);
  if (!parsed_cfa.ok()) return At(head, "cfa", parsed_cfa.status().message());
  common.cfa = *parsed_cfa;
  if (alignment != "high" && alignment != "low")
    return At(head, "alignment", "'" + alignment + "' is unknown; allowed: high, low");
  manifest.alignment = alignment == "high" ? SampleAlignment::kHigh : SampleAlignment::kLow;
  const std::map<int, PixelFormat> formats = {
      {8, PixelFormat::kMono8}, {12, PixelFormat::kMono12}, {16, PixelFormat::kMono16}};
  const auto format = formats.find(manifest.bit_depth);
  if (format == formats.end()) return At(head, "bit_depth", std::to_string(manifest.bit_depth) + " is not 8, 12 or 16");
  common.format = format->second;
  if (saturation_dn > FullScaleDn(common.format))
    return At(head, "saturation",
              std::to_string(saturation_dn) + " exceeds the levels of " + std::to_string(manifest.bit_depth) + " bits");
  return Status::Ok();
}

Result<std::vector<Pose>> ReadPoses(std::vector<TomlTable> tables, const ImportManifest& manifest) {
  std::vector<Pose> poses;
  std::set<int> seen;
  Status twice;
  for (TomlTable& table : tables) {
    Pose pose;
    table.Require("index");
    table.Get("index", pose.index, 0, kMostPoses);
    table.Get("folder", pose.folder);
    table.Get("crop_x", pose.crop_x, 0, manifest.camera_width - 1);
    table.Get("crop_y", pose.crop_y, 0, manifest.camera_height - 1);
    table.Get("width", pose.width, 1, manifest.camera_width);
    table.Get("height", pose.height, 1, manifest.camera_height);
    if (!seen.insert(pose.index).second && pose.index >= 0 && twice.ok())
      twice = At(table, "index", std::to_string(pose.index) + " is used twice");
    poses.push_back(pose);
  }
  if (!twice.ok()) return twice;
  if (poses.empty()) poses.emplace_back();  // a manifest without poses: one, at the root
  return poses;
}

// "g##.png", 7 -> "g07.png"; empty without a run of '#'.
std::string Numbered(const std::string& sequence, int number) {
  const size_t first = sequence.find('#');
  if (first == std::string::npos) return {};
  const size_t last = std::min(sequence.find_first_not_of('#', first), sequence.size());
  char digits[32];
  std::snprintf(digits, sizeof digits, "%0*d", static_cast<int>(std::min<size_t>(last - first, 9)), number);
  return sequence.substr(0, first) + digits + sequence.substr(last);
}

// A code of fewer bits would be read as if it numbered every column: too few, and all of them wrong.
Status CheckBits(const TomlTable& table, const std::string& key, const Pattern& pattern, const Projectors& projectors) {
  if (pattern.kind != PatternKind::kGray) return Status::Ok();
  const bool columns = pattern.axis == PatternAxis::kColumns;
  const int extent = columns ? projectors.width : projectors.height;
  const int needed = GrayBits(extent);
  if (pattern.bits >= needed) return Status::Ok();
  return At(table, key,
            "pattern '" + pattern.ToString() + "' is of a code of " + std::to_string(pattern.bits) + " bits, " +
                std::to_string(extent) + (columns ? " columns" : " rows") + " need " + std::to_string(needed) +
                "; name the planes bit=0/" + std::to_string(needed) +
                " and so on, or give as the projector's size the part of it that shows them");
}

Status AddShot(const TomlTable& table, const std::string& key, const std::string& file, const std::string& pattern,
               const std::string& phase, const Projectors& projectors, Shot shot, std::vector<Shot>& shots) {
  if (file.find('\0') != std::string::npos) return At(table, key, "a file's name must not contain a zero byte");
  const auto parsed = Pattern::Parse(pattern);
  if (!parsed.ok()) return At(table, key, parsed.status().message());
  const Status fits = parsed->Validate(projectors.width, projectors.height);
  if (!fits.ok()) return At(table, key, fits.message());
  SLX_RETURN_IF_ERROR(CheckBits(table, key, *parsed, projectors));
  shot.record.pattern = *parsed;
  shot.record.phase = PhaseOf(parsed->kind);
  if (!phase.empty()) {
    const auto named = ParseCapturePhase(phase);
    if (!named.ok()) return At(table, "phase", named.status().message());
    shot.record.phase = *named;
  }
  if (shot.record.projector >= projectors.count)
    return At(table, "projector",
              std::to_string(shot.record.projector) + " is out of range, allowed: 0 .. " +
                  std::to_string(projectors.count - 1));
  shot.file = file;
  shot.where = table.Where();
  shots.push_back(std::move(shot));
  return Status::Ok();
}

// One entry: `file` with `pattern`, or `sequence` (with `first`) and `patterns`.
Status ReadEntry(TomlTable& table, const Projectors& projectors, const FrameRecord& common, std::vector<Shot>& shots) {
  std::string file, pattern, sequence, phase;
  std::vector<std::string> patterns;
  int first = 0;
  Shot shot{{}, {}, common, -1};
  shot.record.projector = 0;
  table.Get("file", file);
  table.Get("pattern", pattern);
  table.Get("sequence", sequence);
  table.Get("patterns", patterns);
  table.Get("first", first, 0, 99999999);
  table.Get("phase", phase);
  table.Get("projector", shot.record.projector, -1, 15);
  table.Get("exposure_ms", shot.record.exposure_ms, 0.0, 10000.0);
  table.Get("bracket", shot.record.bracket, 0, 7);
  table.Get("pose", shot.pose, 0, kMostPoses);
  if (file.empty() == sequence.empty())
    return Status::Usage(table.Where() + ": an entry needs either file and pattern, or sequence and patterns");
  if (!file.empty()) {
    if (pattern.empty() || !patterns.empty())
      return Status::Usage(table.Where() + ": the entry of '" + file + "' needs one pattern");
    return AddShot(table, "pattern", file, pattern, phase, projectors, shot, shots);
  }
  if (patterns.empty() || !pattern.empty()) return At(table, "sequence", "needs a list of patterns");
  if (Numbered(sequence, 0).empty())
    return At(table, "sequence", "'" + sequence + "' has no '#' in place of the number, such as g##.png");
  for (size_t i = 0; i < patterns.size(); ++i)
    SLX_RETURN_IF_ERROR(AddShot(table, "patterns", Numbered(sequence, first + static_cast<int>(i)), patterns[i], phase,
                                projectors, shot, shots));
  return Status::Ok();
}

Status ReadEntries(std::vector<TomlTable> tables, const Projectors& projectors, const FrameRecord& common,
                   std::vector<Shot>& shots) {
  // Every entry is read, also behind a wrong one: a key that nobody asked for counts as unknown.
  Status first;
  for (TomlTable& table : tables)
    if (const Status status = ReadEntry(table, projectors, common, shots); first.ok()) first = status;
  return first;
}

// Which shots a pose has, in the order of the entries, without asking each shot for each pose.
class ShotsOfPoses {
 public:
  explicit ShotsOfPoses(const std::vector<Shot>& shots) {
    for (size_t i = 0; i < shots.size(); ++i) (shots[i].pose < 0 ? of_each_ : of_one_[shots[i].pose]).push_back(i);
  }
  [[nodiscard]] std::vector<size_t> Of(int pose) const {
    const auto own = of_one_.find(pose);
    if (own == of_one_.end()) return of_each_;
    std::vector<size_t> all;
    std::merge(of_each_.begin(), of_each_.end(), own->second.begin(), own->second.end(), std::back_inserter(all));
    return all;
  }

 private:
  std::vector<size_t> of_each_;
  std::map<int, std::vector<size_t>> of_one_;
};

// A pattern that two frames of a pose show is read once: the last would stand for all of them, and nobody would know.
// White and black may be repeated, since most stages take their mean; of the reference phase, decoding reads one.
class RepeatedFrames {
 public:
  Status Add(const ImportFrame& frame, std::vector<std::string>& notes) {
    const FrameRecord& r = frame.record;
    const auto [first, fresh] = seen_.try_emplace(
        {r.projector, static_cast<int>(r.phase), r.pattern.ToString(), r.pose, r.bracket}, frame.where);
    if (fresh) return Status::Ok();
    const std::string what = "'" + r.pattern.ToString() + "' of projector " + std::to_string(r.projector) +
                             (r.pose >= 0 ? ", pose " + std::to_string(r.pose) : "") + ", phase " + ToString(r.phase);
    const bool white = r.pattern.kind == PatternKind::kWhite, black = r.pattern.kind == PatternKind::kBlack;
    if (!white && !black)
      return Status::Usage(frame.where + ": " + what + " is listed at " + first->second +
                           ", too; name each frame once (another exposure of it is another bracket)");
    // Of black, decoding takes the mean where poses are not numbered.
    if (r.phase == CapturePhase::kReference && (white || r.pose >= 0) && warned_.insert(first->first).second)
      notes.push_back(frame.where + ": " + what + " is listed at " + first->second +
                      ", too; decoding and boards use only the last one");
    return Status::Ok();
  }

 private:
  using Key = std::tuple<int, int, std::string, int, int>;  // projector, phase, pattern, pose, bracket
  std::map<Key, std::string> seen_;                         // where it was first
  std::set<Key> warned_;
};

ImportFrame FrameOf(const Shot& shot, const Pose& pose, const std::filesystem::path& root) {
  ImportFrame frame{root / pose.folder / shot.file, shot.where, shot.record};
  frame.record.pose = pose.index;
  frame.record.crop_x = pose.crop_x;
  frame.record.crop_y = pose.crop_y;
  frame.record.width = pose.width;
  frame.record.height = pose.height;
  return frame;
}

}  // namespace

Result<ImportManifest> ReadImportManifest(const ImportOptions& options) {
  SLX_ASSIGN_OR_RETURN(auto root_table, TomlTable::ParseFile(options.manifest));
  ImportManifest manifest;
  FrameRecord common;
  Projectors projectors;
  const Status head = ReadHead(root_table.Table("import"), manifest, common, projectors);
  const auto poses = ReadPoses(root_table.Tables("pose"), manifest);
  std::vector<Shot> shots;
  const Status entries = ReadEntries(root_table.Tables("file"), projectors, common, shots);
  // Type errors and unknown keys come first: what follows from them would mislead.
  SLX_RETURN_IF_ERROR(root_table.Finish());
  SLX_RETURN_IF_ERROR(head);
  SLX_RETURN_IF_ERROR(poses.status());
  SLX_RETURN_IF_ERROR(entries);
  if (shots.empty()) return Status::Usage(options.manifest.string() + ": names no file; add [[file]] entries");

  const auto root = options.root.empty() ? options.manifest.parent_path() : options.root;
  const ShotsOfPoses shots_of(shots);
  RepeatedFrames repeated;
  for (const Pose& pose : *poses) {
    if (options.pose && *options.pose != pose.index) continue;
    const auto of_pose = shots_of.Of(pose.index);
    if (manifest.frames.size() + of_pose.size() > kMostFrames)
      return Status::Usage(options.manifest.string() + ": names more than " + std::to_string(kMostFrames) +
                           " frames, poses times files; import one pose at a time (--pose)");
    for (const size_t shot : of_pose) {
      manifest.frames.push_back(FrameOf(shots[shot], pose, root));
      SLX_RETURN_IF_ERROR(repeated.Add(manifest.frames.back(), manifest.notes));
    }
  }
  if (manifest.frames.empty())
    return Status::Usage(options.manifest.string() + ": has no pose " + std::to_string(options.pose.value_or(-1)));
  for (size_t i = 0; i < manifest.frames.size(); ++i) manifest.frames[i].record.step = static_cast<int>(i);
  return manifest;
}

}  // namespace stratalux::db
