// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/decode.h"

#include <algorithm>
#include <optional>
#include <set>
#include <utility>

#include "fitter/export/exr_file.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

const std::vector<std::string> kCodeChannels = {"column", "row", "column_sigma", "row_sigma", "reason"};

std::filesystem::path FileOf(const std::filesystem::path& folder, size_t projector) {
  return folder / ("decoded_" + std::to_string(projector) + ".exr");
}

// Sinusoids of one period along an axis.
struct SinusoidSet {
  int period_px = 0, shifts = 0;
  std::vector<const db::FrameRow*> rows = {};  // of those that were captured, in shift order

  [[nodiscard]] bool IsWhole() const { return shifts > 0 && rows.size() == static_cast<size_t>(shifts); }
};

void FindShifts(const SessionFrames& frames, int projector, int pose, PatternAxis axis, SinusoidSet& set) {
  for (int shift = 0; shift < set.shifts; ++shift) {
    const db::FrameRow* row = frames.Find(
        projector, CapturePhase::kSeparation,
        {.kind = PatternKind::kSinusoid, .axis = axis, .period = set.period_px, .shift = shift, .shifts = set.shifts},
        pose);
    if (row != nullptr) set.rows.push_back(row);
  }
}

// Of the plan, or by what an import shows; the finest whole set first.
std::vector<SinusoidSet> SinusoidSets(const SessionFrames& frames, int projector, int pose, PatternAxis axis) {
  std::set<std::pair<int, int>> kinds;  // period; shifts, most first
  if (frames.plan()) {
    kinds.emplace(frames.plan()->separation_period, -frames.plan()->separation_shifts);
  } else {
    for (const db::FrameRow& row : frames.rows()) {
      const FrameRecord& r = row.record;
      if (r.projector == projector && r.pose == pose && r.phase == CapturePhase::kSeparation &&
          r.pattern.kind == PatternKind::kSinusoid && r.pattern.axis == axis)
        kinds.emplace(r.pattern.period, -r.pattern.shifts);
    }
  }
  std::vector<SinusoidSet> sets;
  for (const auto& [period, shifts] : kinds)
    FindShifts(frames, projector, pose, axis, sets.emplace_back(SinusoidSet{period, -shifts}));
  std::ranges::stable_partition(sets, &SinusoidSet::IsWhole);
  return sets;
}

// That the codes are refined by: of equal steps, so that one that lacks a shift is none. The bits alone are read then.
SinusoidSet SinusoidsOf(const SessionFrames& frames, int projector, int pose, PatternAxis axis) {
  auto sets = SinusoidSets(frames, projector, pose, axis);
  return sets.empty() || !sets.front().IsWhole() ? SinusoidSet{} : std::move(sets.front());
}

// Frames of one axis' codes, kept alive while views of them are decoded.
struct AxisFrames {
  std::vector<Image<uint16_t>> positive, inverse, shifts;
  int period_px = 0;  // of the sinusoids
};

enum class Polarity { kPositive, kInverse };

// What all planes of all projectors and both axes have in common.
struct CodeKind {
  ColumnCode code = ColumnCode::kGray;
  int waves_px = 0;  // kMicroPhase

  [[nodiscard]] Pattern Of(PatternAxis axis, int bit, int bits, Polarity polarity) const {
    return {.kind = PatternKind::kGray,
            .axis = axis,
            .bit = bit,
            .bits = bits,
            .inverse = polarity == Polarity::kInverse,
            .code = code,
            .period = waves_px};
  }
  friend bool operator==(const CodeKind&, const CodeKind&) = default;
};

// kUsage: there is more than one (an import may name any pattern).
Result<CodeKind> CodeOf(const SessionFrames& frames) {
  std::optional<Pattern> first;
  for (const db::FrameRow& row : frames.rows()) {
    const Pattern& p = row.record.pattern;
    if (p.kind != PatternKind::kGray) continue;
    if (first && CodeKind{first->code, first->period} != CodeKind{p.code, p.period})
      return Status::Usage("session " + frames.info().id + ": frames of two codes, '" + first->ToString() + "' and '" +
                           p.ToString() + "'; one session has one");
    first = p;
  }
  return first ? CodeKind{first->code, first->period} : CodeKind{};
}

// Whether there is any frame of an axis' code.
bool Captured(const SessionFrames& frames, const CodeKind& code, int projector, int pose, PatternAxis axis, int count,
              Polarity polarity) {
  const int bits = count > 0 ? GrayBits(count) : 0;
  for (int bit = 0; bit < bits; ++bit)
    if (frames.Find(projector, CapturePhase::kCorrespondence, code.Of(axis, bit, bits, polarity), pose) != nullptr)
      return true;
  return false;
}

// All of the code's frames, but for inverses where none was captured at all.
Result<AxisFrames> ReadAxis(const SessionFrames& frames, const CodeKind& code, int projector, int pose,
                            PatternAxis axis, int count, CodeReading reading) {
  std::vector<const db::FrameRow*> rows;
  const int bits = GrayBits(count);
  std::vector<Polarity> polarities = {Polarity::kPositive};
  if (Captured(frames, code, projector, pose, axis, count, Polarity::kInverse))
    polarities.push_back(Polarity::kInverse);
  for (const Polarity polarity : polarities)
    for (int bit = 0; bit < bits; ++bit) {
      SLX_ASSIGN_OR_RETURN(rows.emplace_back(), frames.Require(projector, CapturePhase::kCorrespondence,
                                                               code.Of(axis, bit, bits, polarity), pose));
    }
  const SinusoidSet sinusoids =
      reading == CodeReading::kBitsAlone ? SinusoidSet{} : SinusoidsOf(frames, projector, pose, axis);
  rows.insert(rows.end(), sinusoids.rows.begin(), sinusoids.rows.end());
  SLX_ASSIGN_OR_RETURN(auto images, frames.ReadAll(rows));
  AxisFrames read;
  read.period_px = sinusoids.period_px;
  for (size_t i = 0; i < images.size(); ++i) {
    const size_t kind = i / static_cast<size_t>(bits);
    auto& list = kind == 0 ? read.positive : kind < polarities.size() ? read.inverse : read.shifts;
    list.push_back(std::move(images[i]));
  }
  return read;
}

AxisCode AxisCodeOf(const AxisFrames& frames, const CodeKind& kind, int count) {
  AxisCode code;
  code.code = kind.code;
  code.waves_px = kind.waves_px;
  code.count = count;
  for (size_t b = 0; b < frames.positive.size(); ++b)
    code.bits.push_back({frames.positive[b], frames.inverse.empty() ? RawView{} : RawView{frames.inverse[b]}});
  for (const auto& image : frames.shifts) code.shifts.push_back(image);
  code.period_px = frames.period_px;
  return code;
}

Result<Image<float>> BlackOfPose(const SessionFrames& frames, int projector, int pose) {
  if (pose < 0) return frames.MeanBlack(projector);
  SLX_ASSIGN_OR_RETURN(const auto black,
                       frames.Read(projector, CapturePhase::kReference, {.kind = PatternKind::kBlack}, pose));
  Image<float> mean(black.width(), black.height());
  for (size_t i = 0; i < mean.size(); ++i) mean.pixels()[i] = black.pixels()[i];
  return mean;
}

}  // namespace

CodeSize CodeSizeOf(const SessionFrames& frames) {
  if (frames.plan()) return {frames.plan()->projector_width, frames.plan()->projector_height};
  CodeSize size;
  for (const db::FrameRow& row : frames.rows()) {
    const Pattern& p = row.record.pattern;
    if (p.kind == PatternKind::kGray) (p.axis == PatternAxis::kColumns ? size.columns : size.rows) = 1 << p.bits;
  }
  // Imports of before the manifest was kept say nothing.
  const SessionDevices& devices = frames.info().devices;
  if (devices.projector_width > 0) size.columns = devices.projector_width;
  if (devices.projector_height > 0) size.rows = devices.projector_height;
  return size;
}

CodedAxes CodedAxesOf(const SessionFrames& frames, int projector, int pose) {
  CodedAxes axes;
  for (const db::FrameRow& row : frames.rows()) {
    const FrameRecord& r = row.record;
    if (r.pattern.kind != PatternKind::kGray || r.projector != projector || r.pose != pose) continue;
    (r.pattern.axis == PatternAxis::kRows ? axes.rows : axes.columns) = true;
  }
  return axes;
}

std::string UnreadSinusoids(const SessionFrames& frames, int projector, int pose) {
  if (frames.plan()) return {};
  std::string text;
  for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
    const std::vector<SinusoidSet> sets = SinusoidSets(frames, projector, pose, axis);
    for (size_t i = 0; i < sets.size(); ++i) {
      if (i == 0 && sets[i].IsWhole()) continue;
      const std::string found = std::to_string(sets[i].rows.size()), wanted = std::to_string(sets[i].shifts);
      text += (text.empty() ? "" : "; ") + std::string(axis == PatternAxis::kColumns ? "columns" : "rows") +
              ", period " + std::to_string(sets[i].period_px) + " px: " +
              (sets[i].IsWhole() ? "period " + std::to_string(sets[0].period_px) + " px is read"
                                 : found + " of " + wanted + " shifts, all are needed");
    }
  }
  return text.empty() ? text
                      : "projector " + std::to_string(projector) +
                            (pose >= 0 ? ", pose " + std::to_string(pose) : std::string()) +
                            ": sinusoids that are not read: " + text;
}

Result<DecodeReport> DecodeProjector(const SessionFrames& frames, int projector, int pose, int code_width,
                                     int code_height, const SensorNoise& noise, CodeReading reading) {
  SLX_ASSIGN_OR_RETURN(const CodeKind code, CodeOf(frames));
  SLX_ASSIGN_OR_RETURN(const auto white,
                       frames.Read(projector, CapturePhase::kReference, {.kind = PatternKind::kWhite}, pose));
  SLX_ASSIGN_OR_RETURN(const auto black, BlackOfPose(frames, projector, pose));
  const auto captured = [&](PatternAxis axis, int count) {
    return Captured(frames, code, projector, pose, axis, count, Polarity::kPositive) ||
           Captured(frames, code, projector, pose, axis, count, Polarity::kInverse);
  };
  AxisFrames columns, rows;
  const bool has_rows = captured(PatternAxis::kRows, code_height);
  if (!has_rows || captured(PatternAxis::kColumns, code_width)) {  // where there is nothing, a column's frame is named
    SLX_ASSIGN_OR_RETURN(columns, ReadAxis(frames, code, projector, pose, PatternAxis::kColumns, code_width, reading));
  }
  if (has_rows) {
    SLX_ASSIGN_OR_RETURN(rows, ReadAxis(frames, code, projector, pose, PatternAxis::kRows, code_height, reading));
  }
  DecodeInput input;
  input.white = white;
  input.black = black;
  input.columns = AxisCodeOf(columns, code, code_width);
  input.rows = AxisCodeOf(rows, code, code_height);
  return DecodeGray(input, noise);
}

Result<DecodedFace> DecodeFace(const SessionFrames& frames, Logger& logger, CodeReading reading) {
  const RigCalibration& rig = *frames.calibration();
  const SensorNoise noise = SensorNoise::From(rig.camera);
  DecodedFace face;
  Progress progress(logger, "decode", static_cast<int64_t>(rig.projectors.size()));
  for (int p = 0; p < static_cast<int>(rig.projectors.size()); ++p) {
    const Pinhole& model = rig.projectors[p].model;
    SLX_ASSIGN_OR_RETURN(auto report, DecodeProjector(frames, p, -1, model.width, model.height, noise, reading));
    for (int r = 0; r < kDecodeReasons; ++r) face.counts[r] += report.counts[r];
    face.maps.push_back(std::move(report.map));
    progress.Advance();
  }
  return face;
}

Status SaveDecoded(const std::filesystem::path& folder, const DecodedFace& face) {
  SLX_RETURN_IF_ERROR(ParallelTry(face.maps.size(), [&](size_t p) {
    const DecodedMap& map = face.maps[p];
    Image<float> all(map.reason.width(), map.reason.height(), 5);
    for (size_t i = 0; i < map.reason.size(); ++i) {
      float* site = all.data() + 5 * i;
      site[0] = map.column.pixels()[i];
      site[1] = map.row.pixels()[i];
      site[2] = map.column_sigma.pixels()[i];
      site[3] = map.row_sigma.pixels()[i];
      site[4] = map.reason.pixels()[i];
    }
    return WriteExr(FileOf(folder, p), all, kCodeChannels);
  }));
  return WriteJson(folder / "decode.json", {{"projectors", face.maps.size()}, {"counts", face.counts}});
}

Result<DecodedFace> LoadDecoded(const std::filesystem::path& folder) {
  DecodedFace face;
  size_t projectors = 0;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "decode.json", [&](const nlohmann::json& json) {
    json.at("projectors").get_to(projectors);
    json.at("counts").get_to(face.counts);
  }));
  for (size_t p = 0; p < projectors; ++p) {
    SLX_ASSIGN_OR_RETURN(const auto all, ReadExr(FileOf(folder, p), kCodeChannels));
    const Image<float> empty(all.width(), all.height());
    DecodedMap map{empty, empty, empty, empty, Image<uint8_t>(all.width(), all.height())};
    for (size_t i = 0; i < map.reason.size(); ++i) {
      const float* site = all.data() + 5 * i;
      map.column.pixels()[i] = site[0];
      map.row.pixels()[i] = site[1];
      map.column_sigma.pixels()[i] = site[2];
      map.row_sigma.pixels()[i] = site[3];
      map.reason.pixels()[i] = static_cast<uint8_t>(site[4]);
    }
    face.maps.push_back(std::move(map));
  }
  return face;
}

}  // namespace stratalux::fit
