// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/geometry_stage.h"

#include <algorithm>
#include <cmath>

#include "fitter/photometric/fuse_normals.h"
#include "fitter/reconstruction/smooth_surface.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

// Frames of one axis' codes, kept alive while views of them are decoded.
struct AxisFrames {
  std::vector<Image<uint16_t>> positive, inverse, shifts;
};

Result<AxisFrames> ReadAxis(const SessionFrames& frames, int projector, int pose, PatternAxis axis, int count) {
  AxisFrames read;
  const int bits = GrayBits(count);
  for (int bit = 0; bit < bits; ++bit)
    for (bool inverse : {false, true}) {
      SLX_ASSIGN_OR_RETURN(
          auto image,
          frames.Read(projector, CapturePhase::kCorrespondence,
                      {.kind = PatternKind::kGray, .axis = axis, .bit = bit, .bits = bits, .inverse = inverse}, pose));
      (inverse ? read.inverse : read.positive).push_back(std::move(image));
    }
  if (!frames.plan()) return read;
  const PlanOptions& o = *frames.plan();
  for (int shift = 0; shift < o.separation_shifts; ++shift) {
    const Pattern pattern{.kind = PatternKind::kSinusoid,
                          .axis = axis,
                          .period = o.separation_period,
                          .shift = shift,
                          .shifts = o.separation_shifts};
    if (frames.Find(projector, CapturePhase::kSeparation, pattern, pose) == nullptr) continue;
    SLX_ASSIGN_OR_RETURN(auto image, frames.Read(projector, CapturePhase::kSeparation, pattern, pose));
    read.shifts.push_back(std::move(image));
  }
  return read;
}

AxisCode CodeOf(const AxisFrames& frames, int count, int period) {
  AxisCode code;
  code.count = count;
  for (size_t b = 0; b < frames.positive.size(); ++b) code.bits.push_back({frames.positive[b], frames.inverse[b]});
  for (const auto& image : frames.shifts) code.shifts.push_back(image);
  code.period_px = frames.shifts.empty() ? 0 : period;
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

Result<Separation> SeparateProjector(const SessionFrames& frames, int projector, const RigCalibration& rig,
                                     const SensorNoise& noise) {
  const PlanOptions& o = *frames.plan();
  SLX_ASSIGN_OR_RETURN(const auto white,
                       frames.Read(projector, CapturePhase::kReference, {.kind = PatternKind::kWhite}));
  SLX_ASSIGN_OR_RETURN(const auto black, frames.MeanBlack(projector));
  std::vector<Image<uint16_t>> images;
  SeparationFrames input;
  for (PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows})
    for (int shift = 0; shift < o.separation_shifts; ++shift) {
      SLX_ASSIGN_OR_RETURN(auto image, frames.Read(projector, CapturePhase::kSeparation,
                                                   {.kind = PatternKind::kSinusoid,
                                                    .axis = axis,
                                                    .period = o.separation_period,
                                                    .shift = shift,
                                                    .shifts = o.separation_shifts}));
      images.push_back(std::move(image));
    }
  input.white = white;
  input.black = black;
  for (size_t i = 0; i < images.size(); ++i)
    (i < images.size() / 2 ? input.column_shifts : input.row_shifts).push_back(images[i]);
  SeparationOptions options;
  options.projector_black = rig.projectors[projector].black_level;
  options.sinusoid_amplitude = rig.projectors[projector].SinusoidAmplitude();
  return SeparateSinusoids(input, rig.camera.cfa, noise, options);
}

}  // namespace

SensorNoise NoiseOf(const SessionFrames& frames) {
  if (frames.calibration()) return SensorNoise::From(frames.calibration()->camera);
  const bool eight_bit = frames.rows()[0].record.format == PixelFormat::kMono8;
  return {0.0, eight_bit ? 255.0 : 4095.0, eight_bit ? 20.0 : 4.0, eight_bit ? 1.0 : 3.0};
}

CodeSize CodeSizeOf(const SessionFrames& frames) {
  if (frames.plan()) return {frames.plan()->projector_width, frames.plan()->projector_height};
  CodeSize size;
  for (const db::FrameRow& row : frames.rows()) {
    const Pattern& p = row.record.pattern;
    if (p.kind == PatternKind::kGray) (p.axis == PatternAxis::kColumns ? size.columns : size.rows) = 1 << p.bits;
  }
  return size;
}

Result<DecodeReport> DecodeProjector(const SessionFrames& frames, int projector, int pose, int code_width,
                                     int code_height, const SensorNoise& noise) {
  SLX_ASSIGN_OR_RETURN(const auto white,
                       frames.Read(projector, CapturePhase::kReference, {.kind = PatternKind::kWhite}, pose));
  SLX_ASSIGN_OR_RETURN(const auto black, BlackOfPose(frames, projector, pose));
  SLX_ASSIGN_OR_RETURN(const auto columns, ReadAxis(frames, projector, pose, PatternAxis::kColumns, code_width));
  SLX_ASSIGN_OR_RETURN(const auto rows, ReadAxis(frames, projector, pose, PatternAxis::kRows, code_height));
  const int period = frames.plan() ? frames.plan()->separation_period : 0;
  DecodeInput input;
  input.white = white;
  input.black = black;
  input.columns = CodeOf(columns, code_width, period);
  input.rows = CodeOf(rows, code_height, period);
  return DecodeGray(input, noise);
}

Image<uint8_t> LitQuads(const DecodedMap& decoded, const SurfaceMap& surface, const RigCalibration& rig,
                        int projector) {
  constexpr double kMaxColumns = 3.0;  // scattering displaces a decoded column by less than one
  const int step = QuadStep(rig.camera.cfa);
  Image<uint8_t> lit(surface.width(), surface.height()), eroded(surface.width(), surface.height());
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      const auto at = rig.projectors[projector].ProjectFromCamera(surface.Point(i, j));
      if (!at) continue;
      int agreeing = 0;
      for (int y = j * step; y < (j + 1) * step; ++y)
        for (int x = i * step; x < (i + 1) * step; ++x)
          agreeing += decoded.reason(x, y) == 0 && std::abs(decoded.column(x, y) - at->x()) < kMaxColumns ? 1 : 0;
      lit(i, j) = 2 * agreeing >= step * step ? 1 : 0;
    }
  for (int j = 1; j + 1 < lit.height(); ++j)
    for (int i = 1; i + 1 < lit.width(); ++i) {
      bool inside = true;
      for (int y = -1; y <= 1; ++y)
        for (int x = -1; x <= 1; ++x) inside = inside && lit(i + x, j + y) != 0;
      eroded(i, j) = inside ? 1 : 0;
    }
  return eroded;
}

Image<float> QuadSignal(ImageView<const uint16_t> raw, ImageView<const float> dark, const CameraCalibration& camera) {
  const int step = QuadStep(camera.cfa), channels = QuadChannels(camera.cfa);
  Image<float> quads(raw.width() / step, raw.height() / step, channels);
  for (int j = 0; j < quads.height(); ++j)
    for (int i = 0; i < quads.width(); ++i) {
      float sum[3] = {}, count[3] = {};
      for (int y = j * step; y < (j + 1) * step; ++y)
        for (int x = i * step; x < (i + 1) * step; ++x) {
          const int c = CfaColour(camera.cfa, x, y);
          sum[c] += raw(x, y) >= camera.saturation_dn ? std::nanf("") : static_cast<float>(raw(x, y)) - dark(x, y);
          count[c] += 1.0F;
        }
      for (int c = 0; c < channels; ++c) quads(i, j, c) = sum[c] / count[c];
    }
  return quads;
}

Image<float> QuadVariance(ImageView<const uint16_t> raw, const CameraCalibration& camera) {
  const int step = QuadStep(camera.cfa), channels = QuadChannels(camera.cfa);
  const double read2 = camera.read_noise_dn * camera.read_noise_dn;
  Image<float> quads(raw.width() / step, raw.height() / step, channels);
  for (int j = 0; j < quads.height(); ++j)
    for (int i = 0; i < quads.width(); ++i) {
      double sum[3] = {}, count[3] = {};
      for (int y = j * step; y < (j + 1) * step; ++y)
        for (int x = i * step; x < (i + 1) * step; ++x) {
          const int c = CfaColour(camera.cfa, x, y);
          sum[c] += std::max(raw(x, y) - camera.black_level_dn, 0.0) / camera.gain_e_per_dn + read2;
          count[c] += 1.0;
        }
      for (int c = 0; c < channels; ++c) quads(i, j, c) = static_cast<float>(sum[c] / (count[c] * count[c]));
    }
  return quads;
}

Result<FaceGeometry> ReconstructFace(const SessionFrames& frames, StageClock& clock, Logger& logger) {
  const RigCalibration& rig = *frames.calibration();
  const SensorNoise noise = SensorNoise::From(rig.camera);
  FaceGeometry face;
  clock.Start("decode");
  Progress progress(logger, "decode", static_cast<int64_t>(rig.projectors.size()));
  for (int p = 0; p < static_cast<int>(rig.projectors.size()); ++p) {
    SLX_ASSIGN_OR_RETURN(auto report, DecodeProjector(frames, p, -1, rig.projectors[p].model.width,
                                                      rig.projectors[p].model.height, noise));
    for (int r = 0; r < kDecodeReasons; ++r) face.decode_counts[r] += report.counts[r];
    face.decoded.push_back(std::move(report.map));
    progress.Advance();
  }
  clock.Start("reconstruct");
  SLX_ASSIGN_OR_RETURN(const auto rough, Triangulate(face.decoded, rig));
  face.triangulation = rough.counts;
  SLX_ASSIGN_OR_RETURN(face.surface, SmoothSurface(rough.surface, rig));
  for (int p = 0; p < static_cast<int>(rig.projectors.size()); ++p)
    face.lit.push_back(LitQuads(face.decoded[p], face.surface, rig, p));

  clock.Start("separate");
  std::vector<ImageView<const float>> direct;
  for (int p = 0; p < static_cast<int>(rig.projectors.size()); ++p) {
    SLX_ASSIGN_OR_RETURN(auto separation, SeparateProjector(frames, p, rig, noise));
    face.separation.push_back(std::move(separation.map));
  }
  clock.Start("normals");
  for (const SeparationMap& s : face.separation) direct.push_back(s.direct);
  SLX_ASSIGN_OR_RETURN(face.photometric, EstimateNormals(direct, face.surface, rig, frames.plan()->exposure_ms));
  SLX_ASSIGN_OR_RETURN(face.fused_normal, FuseNormals(face.surface, face.photometric));
  return face;
}

}  // namespace stratalux::fit
