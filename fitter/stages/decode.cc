// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/decode.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "fitter/export/exr_file.h"
#include "fitter/session/quad_signal.h"
#include "fitter/session/sinusoid_sets.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

const std::vector<std::string> kCodeChannels = {"column", "row", "column_sigma", "row_sigma", "reason"};

std::filesystem::path FileOf(const std::filesystem::path& folder, size_t projector) {
  return folder / ("decoded_" + std::to_string(projector) + ".exr");
}

// That the codes are refined by: of equal steps, so that one that lacks a shift is none. The bits alone are read then.
SinusoidSet SinusoidsOf(const SessionFrames& frames, int projector, int pose, PatternAxis axis) {
  auto sets = SinusoidSets(frames, projector, pose, axis);
  return sets.empty() || !sets.front().IsWhole() ? SinusoidSet{} : std::move(sets.front());
}

// Frames of one axis' codes, kept alive while views of them are decoded.
struct AxisFrames {
  std::vector<Image<uint16_t>> positive, inverse;  // by bit; empty where the frame is missing
  std::vector<Image<uint16_t>> shifts;
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

// Of an axis' code, frames that are there and patterns of those that are not.
struct CodeFrames {
  int found = 0;
  std::vector<Pattern> missing;
};

// Inverses count as missing where some were captured.
CodeFrames CodeFramesOf(const SessionFrames& frames, const CodeKind& code, int projector, int pose, PatternAxis axis,
                        int count) {
  CodeFrames of;
  const int bits = count > 0 ? GrayBits(count) : 0;
  for (const Polarity polarity : {Polarity::kPositive, Polarity::kInverse}) {
    CodeFrames half;
    for (int bit = 0; bit < bits; ++bit) {
      const Pattern pattern = code.Of(axis, bit, bits, polarity);
      if (frames.Find(projector, CapturePhase::kCorrespondence, pattern, pose) != nullptr)
        ++half.found;
      else
        half.missing.push_back(pattern);
    }
    if (half.found > 0 || polarity == Polarity::kPositive)
      of.missing.insert(of.missing.end(), half.missing.begin(), half.missing.end());
    of.found += half.found;
  }
  return of;
}

// What there is of the code: a frame that is missing leaves its place empty. kNotFound: there is none at all.
Result<AxisFrames> ReadAxis(const SessionFrames& frames, const CodeKind& code, int projector, int pose,
                            PatternAxis axis, int count, CodeReading reading) {
  const int bits = GrayBits(count);
  AxisFrames read;
  read.positive.resize(static_cast<size_t>(bits));
  read.inverse.resize(static_cast<size_t>(bits));
  std::vector<const db::FrameRow*> rows;
  std::vector<Image<uint16_t>*> places;
  for (const Polarity polarity : {Polarity::kPositive, Polarity::kInverse})
    for (int bit = 0; bit < bits; ++bit) {
      const Pattern pattern = code.Of(axis, bit, bits, polarity);
      const db::FrameRow* row = frames.Find(projector, CapturePhase::kCorrespondence, pattern, pose);
      if (row == nullptr) continue;
      rows.push_back(row);
      places.push_back(&(polarity == Polarity::kPositive ? read.positive : read.inverse)[static_cast<size_t>(bit)]);
    }
  if (rows.empty())
    return frames.Require(projector, CapturePhase::kCorrespondence, code.Of(axis, 0, bits, Polarity::kPositive), pose)
        .status();
  const SinusoidSet sinusoids =
      reading == CodeReading::kBitsAlone ? SinusoidSet{} : SinusoidsOf(frames, projector, pose, axis);
  read.period_px = sinusoids.period_px;
  read.shifts.resize(sinusoids.rows.size());
  for (size_t i = 0; i < read.shifts.size(); ++i) {
    rows.push_back(sinusoids.rows[i]);
    places.push_back(&read.shifts[i]);
  }
  SLX_ASSIGN_OR_RETURN(auto images, frames.ReadAll(rows));
  for (size_t i = 0; i < images.size(); ++i) *places[i] = std::move(images[i]);
  return read;
}

AxisCode AxisCodeOf(const AxisFrames& frames, const CodeKind& kind, int count) {
  AxisCode code;
  code.code = kind.code;
  code.waves_px = kind.waves_px;
  code.count = count;
  for (size_t b = 0; b < frames.positive.size(); ++b) code.bits.push_back({frames.positive[b], frames.inverse[b]});
  for (const auto& image : frames.shifts) code.shifts.push_back(image);
  code.period_px = frames.period_px;
  return code;
}

DecodedMap NothingDecoded(int width, int height) {
  const Image<float> unknown(width, height, 1, std::nanf(""));
  return {unknown, unknown, unknown, unknown,
          Image<uint8_t>(width, height, 1, static_cast<uint8_t>(DecodeReason::kUnlit))};
}

}  // namespace

Result<Image<float>> BlackOfPose(const SessionFrames& frames, int projector, int pose) {
  if (pose < 0) return frames.MeanBlack(projector);
  SLX_ASSIGN_OR_RETURN(const auto black,
                       frames.Read(projector, CapturePhase::kReference, {.kind = PatternKind::kBlack}, pose));
  Image<float> mean(black.width(), black.height());
  for (size_t i = 0; i < mean.size(); ++i) mean.pixels()[i] = black.pixels()[i];
  return mean;
}

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

std::string UnreadPatterns(const SessionFrames& frames, int projector, int pose) {
  std::vector<std::string> parts;
  const CodeSize size = CodeSizeOf(frames);
  const auto code = CodeOf(frames);
  for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
    if (!code.ok()) break;
    const CodeFrames of =
        CodeFramesOf(frames, *code, projector, pose, axis, axis == PatternAxis::kColumns ? size.columns : size.rows);
    for (size_t i = 0; of.found > 0 && i < of.missing.size(); ++i)
      parts.push_back("'" + of.missing[i].ToString() + "' is missing");
  }
  const std::vector<PatternAxis> axes =
      frames.plan() ? frames.sinusoids() : std::vector{PatternAxis::kColumns, PatternAxis::kRows};
  for (const PatternAxis axis : axes) {
    const std::vector<SinusoidSet> sets = SinusoidSets(frames, projector, pose, axis);
    for (size_t i = 0; i < sets.size(); ++i) {
      if ((i == 0 && sets[i].IsWhole()) || sets[i].rows.empty()) continue;
      const std::string found = std::to_string(sets[i].rows.size()), wanted = std::to_string(sets[i].shifts);
      parts.push_back(std::string(AxisName(axis)) + ", sinusoids of period " + std::to_string(sets[i].period_px) +
                      " px: " +
                      (sets[i].IsWhole() ? "period " + std::to_string(sets[0].period_px) + " px is read"
                                         : found + " of " + wanted + " shifts, all are needed"));
    }
  }
  if (parts.empty()) return {};
  std::string text = "projector " + std::to_string(projector) +
                     (pose >= 0 ? ", pose " + std::to_string(pose) : std::string()) + ": codes are read without: ";
  for (size_t i = 0; i < parts.size(); ++i) text += (i == 0 ? "" : "; ") + parts[i];
  return text;
}

Result<DecodeReport> DecodeProjector(const SessionFrames& frames, int projector, int pose, int code_width,
                                     int code_height, const SensorNoise& noise, CodeReading reading) {
  SLX_ASSIGN_OR_RETURN(const CodeKind code, CodeOf(frames));
  const db::FrameRow* white_row = frames.FindWhite(projector, pose);
  if (white_row == nullptr)
    return frames.Require(projector, CapturePhase::kReference, {.kind = PatternKind::kWhite}, pose).status();
  SLX_ASSIGN_OR_RETURN(const auto white, frames.ReadLinear(*white_row));
  SLX_ASSIGN_OR_RETURN(const auto black, BlackOfPose(frames, projector, pose));
  const auto captured = [&](PatternAxis axis, int count) {
    return CodeFramesOf(frames, code, projector, pose, axis, count).found > 0;
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
  const CodeSize size = CodeSizeOf(frames);
  SLX_ASSIGN_OR_RETURN(const CodeKind code, CodeOf(frames));
  // Of a projector without white, black or any code nothing can be said; the others' codes still give a surface.
  const auto has_codes = [&](int p) {
    return frames.FindWhite(p) != nullptr && frames.HasBlack(p) &&
           (CodeFramesOf(frames, code, p, -1, PatternAxis::kColumns, size.columns).found > 0 ||
            CodeFramesOf(frames, code, p, -1, PatternAxis::kRows, size.rows).found > 0);
  };
  std::vector<uint8_t> coded;
  for (int p = 0; p < static_cast<int>(rig.projectors.size()); ++p) coded.push_back(has_codes(p) ? 1 : 0);
  const bool any = std::ranges::count(coded, 1) > 0;
  for (int p = 0; p < static_cast<int>(coded.size()); ++p) {
    const Pinhole& model = rig.projectors[p].model;
    if (any && coded[static_cast<size_t>(p)] == 0) {
      logger.Warning("projector " + std::to_string(p) +
                     ": its white, its black or all of its codes are missing (`stratalux-db show`); the surface is "
                     "found without it. Capture the visitor again");
      face.maps.push_back(NothingDecoded(rig.camera.model.width, rig.camera.model.height));
      face.counts[static_cast<size_t>(DecodeReason::kUnlit)] += std::ssize(face.maps.back().reason.pixels());
      progress.Advance();
      continue;
    }
    if (const std::string note = UnreadPatterns(frames, p, -1); !note.empty()) logger.Warning(note);
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
