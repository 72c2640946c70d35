// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit decode`: projector coordinates of every camera pixel, for visitors and for imported boards alike.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <map>
#include <memory>
#include <optional>
#include <sstream>
#include <tuple>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "db/privacy/export_marker.h"
#include "fitter/apps/run_command.h"
#include "fitter/export/exr_file.h"
#include "fitter/export/pictures.h"
#include "fitter/session/choose_session.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/cloud.h"
#include "fitter/stages/decode.h"
#include "fitter/structured_light/local_homography.h"
#include "shared/base/standard_output.h"
#include "shared/image/png.h"

namespace stratalux::fit {
namespace {

struct DecodeFlags {
  std::string store, session = "latest", out, reference;
  int projector = 0, pose = -1;
  bool json = false, bits_alone = false;
};

// A board's corner as somebody else decoded it.
struct ReferenceCorner {
  Eigen::Vector2d camera_px, projector_px;
};
using Reference = std::multimap<int, ReferenceCorner>;  // by pose

// Lines of pose, board x y, camera u v, projector x y. kUsage: it cannot be read, or has no line of one of `poses`.
Result<Reference> ReadReference(const std::string& file, const std::vector<int>& poses) {
  std::ifstream in(file);
  if (!in) return Status::Usage("cannot read " + file);
  Reference reference;
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    if (line.ends_with('\r')) line.pop_back();
    if (line.empty() || line[0] == '#') continue;
    std::istringstream text(line);
    const std::string where = file + ":" + std::to_string(number) + ": ";
    int pose = 0;
    double v[6];
    if (!(text >> pose)) return Status::Usage(where + "the pose, the first of 7 numbers, is not a whole number");
    for (double& x : v)
      if (!(text >> x)) return Status::Usage(where + "expected 7 numbers (pose, board x y, camera u v, projector x y)");
    if (!(text >> std::ws).eof()) return Status::Usage(where + "more than 7 numbers");
    reference.insert({pose, {{v[2], v[3]}, {v[4], v[5]}}});
  }
  for (const int pose : poses)
    if (!reference.contains(pose))
      return Status::Usage(file + ": has no line of pose " + std::to_string(pose) +
                           "; choose a pose that it has with --pose, or leave out --reference");
  return reference;
}

struct Comparison {
  int corners = 0, found = 0;
  std::optional<double> median_px;  // nullopt: none was found
};

// Distance, projector px, between the corners of a pose and our own sub-pixel look-up.
Comparison CompareCorners(const Reference& reference, int pose, const DecodedMap& map, const Eigen::Vector2d& crop_px) {
  Comparison comparison;
  std::vector<double> errors;
  const auto [begin, end] = reference.equal_range(pose);
  for (auto it = begin; it != end; ++it) {
    ++comparison.corners;
    const auto at = LookUpProjectorPoint(map, it->second.camera_px - crop_px);
    if (at) errors.push_back((at->column_row - it->second.projector_px).norm());
  }
  comparison.found = static_cast<int>(errors.size());
  if (errors.empty()) return comparison;
  std::nth_element(errors.begin(), errors.begin() + static_cast<int64_t>(errors.size() / 2), errors.end());
  comparison.median_px = errors[errors.size() / 2];
  return comparison;
}

// A pose's maps, of the axes that were captured; where nothing could be read they are empty ones, not an earlier run's.
struct PoseMaps {
  std::string name;
  Image<float> column, row;
  CodedAxes captured;
};

// All of them, each whole or not there.
Status WriteMaps(const DecodeFlags& f, const std::string& session, const std::vector<PoseMaps>& all) {
  std::vector<std::pair<std::string, const Image<float>*>> axes;
  std::vector<std::string> files;
  for (const PoseMaps& pose : all)
    for (const auto& [axis, captured, values] : {std::tuple{"_column", pose.captured.columns, &pose.column},
                                                 std::tuple{"_row", pose.captured.rows, &pose.row}}) {
      if (!captured) continue;
      axes.emplace_back(pose.name + axis, values);
      files.push_back(pose.name + axis + ".exr");
      files.push_back(pose.name + axis + ".png");
    }
  const std::filesystem::path out = f.out;
  return db::WriteExport(f.store, "decode", session, out, files, [&]() -> Status {
    for (const auto& [file, values] : axes) {
      SLX_RETURN_IF_ERROR(db::WriteExportedFile(out / (file + ".exr"), [&](const std::filesystem::path& beside) {
        return WriteExr(beside, *values, {"Y"});
      }));
      SLX_RETURN_IF_ERROR(db::WriteExportedFile(out / (file + ".png"), [&](const std::filesystem::path& beside) {
        return WritePng8(beside, ToColourScale(*values, Percentile(*values, 0.01), Percentile(*values, 0.99)));
      }));
    }
    return Status::Ok();
  });
}

Status DecodePose(const SessionFrames& frames, const DecodeFlags& f, int pose, const Reference& reference,
                  nlohmann::ordered_json& results, std::vector<PoseMaps>& maps) {
  const CodeSize code = CodeSizeOf(frames);
  SLX_ASSIGN_OR_RETURN(auto report,
                       DecodeProjector(frames, f.projector, pose, code.columns, code.rows, NoiseOf(frames),
                                       f.bits_alone ? CodeReading::kBitsAlone : CodeReading::kWithSinusoids));
  nlohmann::ordered_json result = {{"projector", f.projector}, {"pose", pose}};
  for (int r = 0; r < kDecodeReasons; ++r) result["pixels"][ToString(static_cast<DecodeReason>(r))] = report.counts[r];
  for (const auto& [axis, counts] :
       {std::pair{"columns", &report.column_bit_counts}, std::pair{"rows", &report.row_bit_counts}})
    for (size_t bits = 0; bits < counts->size(); ++bits)
      if ((*counts)[bits] > 0) result["trusted_bits"][axis][std::to_string(bits)] = (*counts)[bits];
  if (!f.reference.empty()) {
    const db::FrameRow* row = frames.Find(f.projector, CapturePhase::kReference, {.kind = PatternKind::kWhite}, pose);
    const Comparison c =
        CompareCorners(reference, pose, report.map, Eigen::Vector2d(row->record.crop_x, row->record.crop_y));
    result["reference"] = {{"corners", c.corners}, {"found", c.found}, {"median_px", nullptr}};
    if (c.median_px) result["reference"]["median_px"] = *c.median_px;
  }
  if (!f.out.empty())
    maps.push_back({"projector" + std::to_string(f.projector) + (pose >= 0 ? "_pose" + std::to_string(pose) : ""),
                    std::move(report.map.column), std::move(report.map.row), CodedAxesOf(frames, f.projector, pose)});
  results.push_back(result);
  return Status::Ok();
}

std::string AsText(const nlohmann::ordered_json& results) {
  std::ostringstream text;
  for (const auto& r : results) {
    text << "projector " << r["projector"].get<int>() << " pose " << r["pose"].get<int>() << ":";
    for (const auto& [reason, count] : r["pixels"].items()) text << "  " << reason << " " << count.get<int64_t>();
    if (r.contains("reference")) {
      const auto& reference = r["reference"];
      text << "  reference: " << reference["found"].get<int>() << " of " << reference["corners"].get<int>()
           << " corners";
      if (reference["median_px"].is_number())
        text << ", median " << std::fixed << std::setprecision(3) << reference["median_px"].get<double>() << " px";
    }
    text << "\n";
  }
  return text.str();
}

// That the projector has codes of; the others are named. kNotFound: it has none, or none of the one that is asked for.
Result<std::vector<int>> PosesOf(const DecodeFlags& f, const SessionFrames& frames, Logger& logger) {
  const std::string session = "session " + frames.info().id, projector = "projector " + std::to_string(f.projector);
  std::vector<int> poses = CodedPoses(frames, f.projector);
  if (f.pose >= 0) std::erase_if(poses, [&](int pose) { return pose != f.pose; });
  if (poses.empty())
    return Status::NotFound(session + " has no codes of " + projector +
                            (f.pose >= 0 ? " in pose " + std::to_string(f.pose) : ""));
  for (const int pose : frames.poses())
    if (f.pose < 0 && pose >= 0 && std::ranges::find(poses, pose) == poses.end())
      logger.Warning(session + ": pose " + std::to_string(pose) + " has no codes of " + projector + " and is left out");
  return poses;
}

Status Decode(const DecodeFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(f.store, f.session, SessionUse::kFrames, logger));
  SLX_ASSIGN_OR_RETURN(const auto frames, SessionFrames::Open(f.store, chosen));
  for (const std::string& note : frames.store().notes()) logger.Warning(note);
  if (frames.rows().empty()) return Status::NotFound("session " + frames.info().id + " has no frames");
  SLX_ASSIGN_OR_RETURN(const std::vector<int> poses, PosesOf(f, frames, logger));
  Reference reference;
  if (!f.reference.empty()) {
    SLX_ASSIGN_OR_RETURN(reference, ReadReference(f.reference, poses));
  }
  nlohmann::ordered_json results = nlohmann::ordered_json::array();
  std::vector<PoseMaps> maps;
  for (const int pose : poses) {
    if (const std::string note = UnreadPatterns(frames, f.projector, pose); !note.empty() && !f.bits_alone)
      logger.Warning(note);
    SLX_RETURN_IF_ERROR(DecodePose(frames, f, pose, reference, results, maps));
  }
  if (!f.out.empty()) SLX_RETURN_IF_ERROR(WriteMaps(f, frames.info().id, maps));
  return WriteStdout(f.json ? results.dump(1) + "\n" : AsText(results));
}

}  // namespace

void AddDecodeCommand(CLI::App& app, int& exit_code) {
  auto flags = std::make_shared<DecodeFlags>();
  auto* verb =
      app.add_subcommand("decode", "Projector coordinates of every camera pixel; works on imported boards too");
  verb->footer("Example:\n  stratalux-fit decode latest --store store --out decoded --reference reference_corners.txt");
  verb->add_option("session", flags->session, "Session: id, unique prefix, or latest")->capture_default_str();
  verb->add_option("--store", flags->store, "Store folder")->envname("STRATALUX_STORE")->required();
  verb->add_option("--projector", flags->projector, "Projector")->check(CLI::Range(0, 15))->capture_default_str();
  verb->add_option("--pose", flags->pose, "Only this board pose")->check(CLI::Range(0, 10000));
  verb->add_option("--out", flags->out, "Folder for column and row maps (EXR, PNG)");
  verb->add_option("--reference", flags->reference,
                   "Corner file to compare with (pose, board x y, camera u v, projector x y)");
  verb->add_flag("--bits-alone", flags->bits_alone, "Ignore the captured sinusoids");
  verb->add_flag("--json", flags->json, "Machine-readable result on stdout");
  verb->callback([flags, &exit_code] {
    Logger logger;
    const Status status = Decode(*flags, logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
}

}  // namespace stratalux::fit
