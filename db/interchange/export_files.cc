// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/export_files.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <ranges>
#include <set>
#include <tuple>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/interchange/image_file.h"
#include "db/privacy/export_marker.h"
#include "shared/base/read_file.h"
#include "shared/image/png.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

std::string TextOf(const Json& json) { return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n"; }

Status WriteImage(const fs::path& file, ExportFormat format, PixelFormat pixels, const Image<uint16_t>& image) {
  if (pixels != PixelFormat::kMono8)
    return format == ExportFormat::kPng ? WritePng16(file, image.view()) : WriteTiff16(file, image.view());
  Image<uint8_t> narrow(image.width(), image.height(), image.channels());
  std::transform(image.pixels().begin(), image.pixels().end(), narrow.data(),
                 [](uint16_t v) { return static_cast<uint8_t>(v); });
  const auto view = std::as_const(narrow).view();
  return format == ExportFormat::kPng ? WritePng8(file, view) : WriteTiff8(file, view);
}

// An import counts every frame that its manifest lists, and takes no pattern twice: without those that failed their
// check, and of a pattern that was shot again the last. White and black stay, of which stages take means.
std::vector<FrameRow> ThatCount(const std::vector<FrameRow>& frames) {
  std::set<std::tuple<int, CapturePhase, std::string, int, int>> later;
  std::vector<FrameRow> counting;
  for (const FrameRow& frame : std::views::reverse(frames)) {
    const FrameRecord& r = frame.record;
    if (r.level_check == LevelCheck::kFailed) continue;
    const bool repeated = !later.emplace(r.projector, r.phase, r.pattern.ToString(), r.pose, r.bracket).second;
    if (repeated && r.pattern.kind != PatternKind::kWhite && r.pattern.kind != PatternKind::kBlack) continue;
    counting.push_back(frame);
  }
  std::ranges::reverse(counting);
  return counting;
}

// The projector's size by the plan, or as an earlier import said; else what its codes can number, and any size where
// there are none.
SessionDevices DevicesFor(const SessionInfo& info, const std::vector<FrameRow>& frames) {
  constexpr int kLargestProjector = 8192;
  SessionDevices devices = info.devices;
  if (const auto plan = PlanOptionsFromJson(info.plan_json); !info.plan_json.empty() && plan.ok()) {
    devices.projector_width = plan->projector_width;
    devices.projector_height = plan->projector_height;
  }
  for (const auto& [axis, size] : {std::pair{PatternAxis::kColumns, &devices.projector_width},
                                   std::pair{PatternAxis::kRows, &devices.projector_height}}) {
    if (*size > 0) continue;
    const auto code = std::ranges::find_if(frames, [axis](const FrameRow& f) {
      return f.record.pattern.kind == PatternKind::kGray && f.record.pattern.axis == axis;
    });
    *size = code == frames.end() ? kLargestProjector : std::min(1 << code->record.pattern.bits, kLargestProjector);
  }
  return devices;
}

const char* AlignmentOf(PixelFormat format) {
  return format == PixelFormat::kMono12 ? "high: value * 16" : "as they are";
}

}  // namespace

Result<Written> WriteFrameOnce(const fs::path& file, ExportFormat format, PixelFormat pixels, Image<uint16_t> image) {
  if (pixels == PixelFormat::kMono12)
    for (uint16_t& v : image.pixels()) v = static_cast<uint16_t>(v << 4);
  std::error_code error;
  if (fs::exists(file, error)) {
    const auto there = ReadImageFile(file);
    const bool same = there.ok() && there->image.width() == image.width() && there->image.height() == image.height() &&
                      there->image.channels() == image.channels() &&
                      std::equal(image.pixels().begin(), image.pixels().end(), there->image.pixels().begin());
    if (same) return Written::kBefore;
    return Status::Integrity(file.string() + " already exists and holds other pixels; choose another folder");
  }
  const fs::path part = file.string() + ".part";
  Status written = WriteImage(part, format, pixels, image);
  if (written.ok()) {
    fs::rename(part, file, error);
    if (!error) return Written::kNow;
    written = Status::Failed("cannot move " + part.string() + ": " + error.message());
  }
  fs::remove(part, error);
  return written;
}

Result<Written> WriteTextOnce(const fs::path& file, const std::string& text) {
  std::error_code error;
  if (fs::exists(file, error)) {
    const auto there = ReadFile(file, kAnyFileSize);
    if (there.ok() && *there == text) return Written::kBefore;
    return Status::Integrity(file.string() + " already exists and differs; choose another folder");
  }
  SLX_RETURN_IF_ERROR(ReplaceFile(file, text));
  return Written::kNow;
}

std::string ExportedName(const FrameRow& frame, ExportFormat format) {
  char prefix[24];
  std::snprintf(prefix, sizeof prefix, "%06lld-", static_cast<long long>(frame.id));
  std::string name = prefix;
  for (char c : frame.record.pattern.ToString()) name += std::isalnum(static_cast<unsigned char>(c)) != 0 ? c : '-';
  return name + (format == ExportFormat::kPng ? ".png" : ".tif");
}

std::string FramesJson(const std::vector<FrameRow>& frames, ExportFormat format) {
  Json json = Json::array();
  for (const FrameRow& f : frames) {
    const FrameRecord& r = f.record;
    json.push_back({{"frame", f.id},
                    {"file", "frames/" + ExportedName(f, format)},
                    {"values", AlignmentOf(r.format)},
                    {"bit_depth", BitDepth(r.format)},
                    {"step", r.step},
                    {"projector", r.projector},
                    {"phase", ToString(r.phase)},
                    {"pattern", r.pattern.ToString()},
                    {"bracket", r.bracket},
                    {"pose", r.pose},
                    {"retry", r.retry},
                    {"retake_cause", r.retake_cause},
                    {"trigger_number", r.trigger_number},
                    {"trigger_ns", r.trigger_time.ns},
                    {"sync_ns", r.sync_time.ns},
                    {"driver_sequence", r.driver_sequence},
                    {"frame_ns", r.frame_time.ns},
                    {"frame_clock", static_cast<int>(r.frame_clock)},
                    {"exposure_ms", r.exposure_ms},
                    {"gain", r.gain},
                    {"level_check", static_cast<int>(r.level_check)},
                    {"mean_dn", r.mean_dn},
                    {"cfa", static_cast<int>(r.cfa)},
                    {"width", r.width},
                    {"height", r.height},
                    {"channels", r.channels},
                    {"crop_x", r.crop_x},
                    {"crop_y", r.crop_y},
                    {"stored_hash", f.hash}});
  }
  return TextOf(json);
}

namespace {

std::string TomlText(const std::string& text) {
  std::string quoted = "\"";
  char escape[8];
  for (char c : text) {
    if (c == '"' || c == '\\') quoted += '\\';
    if (static_cast<unsigned char>(c) >= 0x20 && c != 0x7f) {
      quoted += c;
    } else {
      std::snprintf(escape, sizeof escape, "\\u%04X", static_cast<unsigned>(static_cast<unsigned char>(c)));
      quoted += escape;
    }
  }
  return quoted + "\"";
}

}  // namespace

std::string ImportToml(const SessionInfo& info, const std::vector<FrameRow>& all, ExportFormat format) {
  const std::vector<FrameRow> frames = ThatCount(all);
  if (frames.empty()) return {};
  constexpr std::array<const char*, 5> kCfa = {"mono", "rggb", "bggr", "grbg", "gbrg"};
  const FrameRecord& first = frames.front().record;
  int width = 0, height = 0, projectors = 1;
  std::set<int> poses;
  for (const FrameRow& f : frames) {
    const FrameRecord& r = f.record;
    if (r.format != first.format || r.cfa != first.cfa || r.channels != 1 || r.projector < -1) return {};
    width = std::max(width, r.crop_x + r.width);
    height = std::max(height, r.crop_y + r.height);
    projectors = std::max(projectors, r.projector + 1);
    poses.insert(r.pose);
  }
  const SessionDevices devices = DevicesFor(info, frames);
  char text[160];
  std::string toml =
      "# `stratalux-db import --manifest import.toml` stores these frames as a session again.\n[import]\nrig = " +
      TomlText(info.rig) + "\nkind = \"" + ToString(info.kind) + "\"\n" +
      (info.visitor.empty() ? "" : "visitor = " + TomlText(info.visitor) + "\n");
  toml += "camera_width = " + std::to_string(std::max(width, devices.camera_width)) +
          "\ncamera_height = " + std::to_string(std::max(height, devices.camera_height)) +
          "\nbit_depth = " + std::to_string(BitDepth(first.format)) + "\ncfa = \"" +
          kCfa[static_cast<size_t>(first.cfa)] + "\"\nprojectors = " + std::to_string(projectors) +
          "\nprojector_width = " + std::to_string(devices.projector_width) +
          "\nprojector_height = " + std::to_string(devices.projector_height) + "\n";
  if (devices.saturation_dn > 0.0) toml += "saturation = " + std::to_string(std::lround(devices.saturation_dn)) + "\n";
  for (int pose : poses) {
    if (pose < 0) continue;
    const auto any =
        std::find_if(frames.begin(), frames.end(), [pose](const FrameRow& f) { return f.record.pose == pose; });
    toml += "[[pose]]\nindex = " + std::to_string(pose) + "\ncrop_x = " + std::to_string(any->record.crop_x) +
            "\ncrop_y = " + std::to_string(any->record.crop_y) + "\n";
  }
  for (const FrameRow& f : frames) {
    const FrameRecord& r = f.record;
    std::snprintf(text, sizeof text, "projector = %d\nbracket = %d\nexposure_ms = %.17g\n", r.projector, r.bracket,
                  r.exposure_ms);
    std::string exposure = text;
    if (exposure.find_first_of(".e", exposure.rfind('=')) == std::string::npos)
      exposure.insert(exposure.size() - 1, ".0");
    toml += "[[file]]\nfile = " + TomlText("frames/" + ExportedName(f, format)) +
            "\npattern = " + TomlText(r.pattern.ToString()) + "\nphase = \"" + ToString(r.phase) + "\"\n" + exposure;
    if (r.pose >= 0) toml += "pose = " + std::to_string(r.pose) + "\n";
  }
  return toml;
}

Status PrepareExportFolder(const fs::path& folder, const std::string& id) {
  const fs::path marker = ExportMarker(folder, id);
  std::error_code error;
  if (!fs::exists(marker, error) && fs::exists(folder, error) && !fs::is_empty(folder, error))
    return Status::Usage(folder.string() + " is not empty and not an interrupted export of session " + id +
                         "; choose another folder");
  return MakeFolder(folder / "frames");
}

}  // namespace stratalux::db
