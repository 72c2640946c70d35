// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_frames.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>

#include <xxhash.h>

#include "db/interchange/crate_files.h"
#include "db/interchange/image_file.h"

namespace stratalux::db {
namespace {

constexpr std::array kFrameColumns = {
    "frame",    "file",        "step",           "projector",      "phase",       "pattern", "bracket",
    "pose",     "retry",       "retake_cause",   "trigger_number", "trigger_ns",  "sync_ns", "driver_sequence",
    "frame_ns", "frame_clock", "exposure_ms",    "gain",           "level_check", "mean_dn", "format",
    "cfa",      "width",       "height",         "channels",       "crop_x",      "crop_y",  "pixel_xxh3_128",
    "codec",    "segment",     "stored_xxh3_128"};
constexpr std::array kClocks = {"unknown", "monotonic", "simulated"};
constexpr std::array kChecks = {"not-checked", "passed", "failed"};
constexpr std::array kFormats = {"", "mono8", "mono12", "mono16"};
constexpr std::array kCfas = {"mono", "rggb", "bggr", "grbg", "gbrg"};
constexpr size_t kLongestLine = 8192;  // bytes

std::vector<std::string> Cells(const CrateFrame& frame) {
  const FrameRecord& r = frame.row.record;
  const auto name = [](const auto& names, auto value) {
    const auto index = static_cast<size_t>(value);
    return std::string(index < names.size() ? names[index] : "");
  };
  return {std::to_string(frame.row.id),
          frame.file,
          std::to_string(r.step),
          std::to_string(r.projector),
          ToString(r.phase),
          r.pattern.ToString(),
          std::to_string(r.bracket),
          std::to_string(r.pose),
          std::to_string(r.retry),
          r.retake_cause,
          std::to_string(r.trigger_number),
          std::to_string(r.trigger_time.ns),
          std::to_string(r.sync_time.ns),
          std::to_string(r.driver_sequence),
          std::to_string(r.frame_time.ns),
          name(kClocks, r.frame_clock),
          ShortestText(r.exposure_ms),
          ShortestText(r.gain),
          name(kChecks, r.level_check),
          ShortestText(r.mean_dn),
          name(kFormats, r.format),
          name(kCfas, r.cfa),
          std::to_string(r.width),
          std::to_string(r.height),
          std::to_string(r.channels),
          std::to_string(r.crop_x),
          std::to_string(r.crop_y),
          frame.pixel_hash,
          frame.row.codec,
          frame.row.segment,
          frame.row.hash};
}

std::optional<std::vector<std::string>> SplitCsv(const std::string& line) {
  std::vector<std::string> cells(1);
  bool quoted = false;
  for (size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    if (quoted && c == '"' && i + 1 < line.size() && line[i + 1] == '"') {
      cells.back() += line[++i];
    } else if (c == '"') {
      if (!quoted && !cells.back().empty()) return std::nullopt;
      quoted = !quoted;
    } else if (c == ',' && !quoted) {
      cells.emplace_back();
    } else {
      cells.back() += c;
    }
  }
  return quoted ? std::nullopt : std::optional(std::move(cells));
}

bool IsHash128(const std::string& text) {
  return text.size() == 32 && text.find_first_not_of("0123456789abcdef") == std::string::npos;
}

// Takes the cells of one line in their order; the first that is wrong is kept.
class CellReader {
 public:
  explicit CellReader(const std::vector<std::string>& cells) : cells_(cells) {}

  std::string Text() { return cells_[next_++]; }
  template <typename T>
  void Integer(T& value, int64_t least, int64_t most) {
    const std::string& text = cells_[next_++];
    int64_t number = 0;
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), number);
    if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size() || number < least || number > most)
      return Wrong("not a whole number from " + std::to_string(least) + " to " + std::to_string(most));
    value = static_cast<T>(number);
  }
  void Nanoseconds(int64_t& value) { Integer(value, INT64_MIN, INT64_MAX); }
  void Real(double& value) {
    const std::string& text = cells_[next_++];
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
    if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size() || !std::isfinite(value))
      Wrong("not a finite number");
  }
  template <typename T, size_t N>
  void Name(T& value, const std::array<const char*, N>& names) {
    const std::string& text = cells_[next_++];
    const auto found = std::find(names.begin(), names.end(), text);
    if (text.empty()) return Wrong("nothing");
    if (found == names.end()) return Unknown("unknown");
    value = static_cast<T>(found - names.begin());
  }
  void Wrong(const std::string& what) { Note(StatusCode::kIntegrity, what); }
  // A word that a later version may know.
  void Unknown(const std::string& what) { Note(StatusCode::kNewerSchema, what + "; a newer stratalux may know it"); }
  // Of the first cell that is not right.
  [[nodiscard]] const Status& status() const { return status_; }

 private:
  void Note(StatusCode code, const std::string& what) {
    if (status_.ok())
      status_ =
          Status(code, std::string(kFrameColumns[next_ - 1]) + " '" + cells_[next_ - 1].substr(0, 80) + "': " + what);
  }
  const std::vector<std::string>& cells_;
  size_t next_ = 0;
  Status status_;
};

// The cells of a line into the frame.
Status ReadCells(const std::vector<std::string>& line, CrateFrame& frame) {
  CellReader cells(line);
  FrameRecord& r = frame.row.record;
  cells.Integer(frame.row.id, 0, INT64_MAX - 1);
  frame.file = cells.Text();
  if (!IsCratePath(frame.file) || !frame.file.starts_with("frames/")) cells.Wrong("not a file in frames/");
  cells.Integer(r.step, INT32_MIN, INT32_MAX);
  cells.Integer(r.projector, INT32_MIN, INT32_MAX);
  if (const auto phase = ParseCapturePhase(cells.Text()); phase.ok())
    r.phase = *phase;
  else
    cells.Unknown(phase.status().message());
  const std::string pattern_text = cells.Text();
  if (const auto pattern = Pattern::Parse(pattern_text); pattern.ok() && pattern->ToString().size() < 64)
    r.pattern = *pattern;
  else
    cells.Wrong("no pattern");
  cells.Integer(r.bracket, INT32_MIN, INT32_MAX);
  cells.Integer(r.pose, INT32_MIN, INT32_MAX);
  cells.Integer(r.retry, INT32_MIN, INT32_MAX);
  r.retake_cause = cells.Text();
  if (r.retake_cause.size() > 31) cells.Wrong("longer than 31 bytes");
  cells.Nanoseconds(r.trigger_number);
  cells.Nanoseconds(r.trigger_time.ns);
  cells.Nanoseconds(r.sync_time.ns);
  cells.Nanoseconds(r.driver_sequence);
  cells.Nanoseconds(r.frame_time.ns);
  cells.Name(r.frame_clock, kClocks);
  cells.Real(r.exposure_ms);
  cells.Real(r.gain);
  cells.Name(r.level_check, kChecks);
  cells.Real(r.mean_dn);
  cells.Name(r.format, kFormats);
  cells.Name(r.cfa, kCfas);
  cells.Integer(r.width, 1, kLargestSide);
  cells.Integer(r.height, 1, kLargestSide);
  cells.Integer(r.channels, 1, 3);
  if (r.channels == 2) cells.Wrong("1 or 3");
  cells.Integer(r.crop_x, INT32_MIN, INT32_MAX);
  cells.Integer(r.crop_y, INT32_MIN, INT32_MAX);
  frame.pixel_hash = cells.Text();
  if (!IsHash128(frame.pixel_hash)) cells.Wrong("not 32 hex digits");
  frame.row.codec = cells.Text();
  if (frame.row.codec != "raw8" && frame.row.codec != "raw12" && frame.row.codec != "raw16" &&
      frame.row.codec != "delta")
    cells.Unknown("is not one of raw8, raw12, raw16, delta");
  frame.row.segment = cells.Text();
  frame.row.hash = cells.Text();
  if (!IsHash128(frame.row.hash)) cells.Wrong("not 32 hex digits");
  return cells.status();
}

}  // namespace

std::string CratePixelHash(PixelFormat format, const Image<uint16_t>& image) {
  XXH128_hash_t hash;
  if (format == PixelFormat::kMono8) {
    std::vector<uint8_t> narrow(image.size());
    std::transform(image.pixels().begin(), image.pixels().end(), narrow.begin(),
                   [](uint16_t v) { return static_cast<uint8_t>(v); });
    hash = XXH3_128bits(narrow.data(), narrow.size());
  } else {
    hash = XXH3_128bits(image.data(), image.size() * sizeof(uint16_t));
  }
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, hash);
  std::string text;
  char digits[3];
  for (const unsigned char byte : canonical.digest) {
    std::snprintf(digits, sizeof digits, "%02x", byte);
    text += digits;
  }
  return text;
}

std::string CsvLine(const std::vector<std::string>& cells) {
  std::string line;
  for (size_t i = 0; i < cells.size(); ++i) {
    if (i > 0) line += ',';
    if (cells[i].find_first_of(",\"\r\n") == std::string::npos) {
      line += cells[i];
      continue;
    }
    line += '"';
    for (const char c : cells[i]) line += c == '"' ? std::string("\"\"") : std::string(1, c);
    line += '"';
  }
  return line + "\n";
}

std::string ShortestText(double value) {
  std::array<char, 32> text{};
  return {text.data(), std::to_chars(text.data(), text.data() + text.size(), value).ptr};
}

std::string CrateFramesHeader() { return CsvLine({kFrameColumns.begin(), kFrameColumns.end()}); }
std::string CrateFrameLine(const CrateFrame& frame) { return CsvLine(Cells(frame)); }

Status CrateFrameReader::Wrong(const std::string& what) const {
  return Status::Integrity(file_ + ":" + std::to_string(line_) + ": " + what);
}

Result<bool> CrateFrameReader::ReadLine(std::string& line) {
  ++line_;
  line.clear();
  int c = in_.get();
  if (c == std::ifstream::traits_type::eof()) return false;
  for (bool quoted = false; c != std::ifstream::traits_type::eof() && (c != '\n' || quoted); c = in_.get()) {
    quoted ^= c == '"';
    line += static_cast<char>(c);
    if (line.size() > kLongestLine) return Wrong("a line of more than " + std::to_string(kLongestLine) + " bytes");
  }
  if (c == std::ifstream::traits_type::eof()) return Wrong("the table is cut off");
  return true;
}

Result<CrateFrameReader> CrateFrameReader::Open(const std::filesystem::path& file) {
  CrateFrameReader reader;
  reader.file_ = file.string();
  reader.in_.open(file, std::ios::binary);
  if (!reader.in_.good()) return Status::NotFound("cannot open " + reader.file_);
  std::string line;
  SLX_ASSIGN_OR_RETURN(const bool any, reader.ReadLine(line));
  if (any && line + "\n" == CrateFramesHeader()) return reader;
  const std::string ours = CrateFramesHeader();
  if (line.starts_with(ours.substr(0, ours.size() - 1) + ","))
    return Status(StatusCode::kNewerSchema, reader.file_ + ": has columns that this program does not know; a newer " +
                                                "Stratalux wrote it: update this one");
  return reader.Wrong("not the columns of frames.csv");
}

Result<bool> CrateFrameReader::Next(CrateFrame& frame) {
  std::string line;
  SLX_ASSIGN_OR_RETURN(const bool any, ReadLine(line));
  if (!any) return false;
  const auto cells = SplitCsv(line);
  if (!cells || cells->size() != kFrameColumns.size())
    return Wrong("not " + std::to_string(kFrameColumns.size()) + " cells");
  frame = {};
  SLX_RETURN_IF_ERROR(ReadCells(*cells, frame).WithContext(file_ + ":" + std::to_string(line_)));
  if (frame.row.id <= last_frame_) return Wrong("frame " + std::to_string(frame.row.id) + " is out of order");
  last_frame_ = frame.row.id;
  // Segments count up from 1; a frame lies in the last one or begins the next.
  char name[32];
  std::snprintf(name, sizeof name, "frames-%04lld.seg", static_cast<long long>(segment_));
  if (frame.row.segment != name) {
    std::snprintf(name, sizeof name, "frames-%04lld.seg", static_cast<long long>(++segment_));
    if (frame.row.segment != name) return Wrong("segment '" + frame.row.segment.substr(0, 40) + "' is not " + name);
  }
  return true;
}

}  // namespace stratalux::db
