// SPDX-License-Identifier: Apache-2.0
#include "fitter/separation/separate.h"

#include <cmath>
#include <functional>
#include <optional>
#include <string>

#include "fitter/structured_light/sinusoid.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

// One site's solution, dn above black.
struct SiteLight {
  double direct = 0.0;
  double total = 0.0;
  double direct_variance = 0.0;
  double total_variance = 0.0;
  bool saturated = false;
};

using SiteSolver = std::function<SiteLight(size_t site)>;

double TotalScale(const SeparationOptions& options) { return 1.0 / (1.0 - options.projector_black); }

// White minus black over 1 - b, the common part of both solvers.
SiteLight WhiteLight(const SeparationFrames& frames, size_t site, const SensorNoise& noise,
                     const SeparationOptions& options) {
  const double white = frames.white.data()[site], black = frames.black.data()[site];
  const double scale = TotalScale(options);
  SiteLight light;
  light.saturated = white >= noise.saturation_dn;
  light.total = (white - black) * scale;
  light.total_variance = (noise.VarianceDn2(white) + noise.VarianceDn2(black)) * scale * scale;
  return light;
}

SiteLight SolveSinusoids(const SeparationFrames& frames, size_t site, const SensorNoise& noise,
                         const SeparationOptions& options, const ShiftTable& columns, const ShiftTable& rows) {
  SiteLight light = WhiteLight(frames, site, noise, options);
  int axes = 0;
  double sum = 0.0, variance = 0.0;
  for (const bool along_columns : {true, false}) {
    const auto& shifts = along_columns ? frames.column_shifts : frames.row_shifts;
    if (shifts.empty()) continue;
    const Harmonic h = HarmonicAt(shifts, site, along_columns ? columns : rows, noise);
    light.saturated |= h.saturated;
    sum += h.amplitude_dn;
    variance += h.amplitude_sigma_dn * h.amplitude_sigma_dn;
    ++axes;
  }
  const double scale = TotalScale(options) / (options.sinusoid_amplitude * axes);
  light.direct = sum * scale;
  light.direct_variance = variance * scale * scale;
  return light;
}

SiteLight SolveCheckerboards(const SeparationFrames& frames, size_t site, const SensorNoise& noise,
                             const SeparationOptions& options) {
  SiteLight light = WhiteLight(frames, site, noise, options);
  double high = -INFINITY, low = INFINITY;
  for (const auto& frame : frames.checkerboards) {
    high = std::max<double>(high, frame.data()[site]);
    low = std::min<double>(low, frame.data()[site]);
  }
  light.saturated |= high >= noise.saturation_dn;
  // The black frame holds ambient + b (L_d + L_g). Lit fraction a = 1/2: both coefficients of L_g are (1 + b) / 2, so
  // L+ - L- = (1 - b) L_d and L+ + L- = (1 + b)(L_d + L_g).
  const double b = options.projector_black;
  const double ambient = frames.black.data()[site] - b * light.total;
  light.direct = (high - low) / (1.0 - b);
  light.total = (high + low - 2.0 * ambient) / (1.0 + b);
  const double variance = noise.VarianceDn2(high) + noise.VarianceDn2(low);
  light.direct_variance = variance / ((1.0 - b) * (1.0 - b));
  light.total_variance = variance / ((1.0 + b) * (1.0 + b));
  return light;
}

class QuadSeparator {
 public:
  QuadSeparator(const SeparationFrames& frames, Cfa cfa, const SensorNoise& noise, const SeparationOptions& options,
                SiteSolver solve)
      : frames_(frames), cfa_(cfa), noise_(noise), options_(options), solve_(std::move(solve)) {}

  void SeparateQuad(int i, int j, SeparationMap& map) const {
    const int step = QuadStep(cfa_), channels = QuadChannels(cfa_);
    std::array<SiteLight, 3> sum{};
    std::array<int, 3> sites{};
    for (int y = step * j; y < step * (j + 1); ++y)
      for (int x = step * i; x < step * (i + 1); ++x) {
        const int c = CfaColour(cfa_, x, y);
        const SiteLight site = solve_(static_cast<size_t>(y) * frames_.white.width() + x);
        sum[c].direct += site.direct;
        sum[c].total += site.total;
        sum[c].direct_variance += site.direct_variance;
        sum[c].total_variance += site.total_variance;
        sum[c].saturated |= site.saturated;
        ++sites[c];
      }
    SeparationReason reason = SeparationReason::kValid;
    for (int c = 0; c < channels; ++c)
      if (reason == SeparationReason::kValid) reason = Judge(sum[c]);
    map.reason(i, j) = static_cast<uint8_t>(reason);
    for (int c = 0; c < channels; ++c) {
      if (!sum[c].saturated) map.white(i, j, c) = static_cast<float>(sum[c].total / sites[c]);
      if (reason != SeparationReason::kValid && reason != SeparationReason::kUnlit) continue;
      map.direct(i, j, c) = static_cast<float>(sum[c].direct / sites[c]);
      map.direct_variance(i, j, c) = static_cast<float>(sum[c].direct_variance / (sites[c] * sites[c]));
      if (reason == SeparationReason::kUnlit) continue;
      map.global(i, j, c) = static_cast<float>((sum[c].total - sum[c].direct) / sites[c]);
    }
  }

 private:
  [[nodiscard]] SeparationReason Judge(const SiteLight& sum) const {
    if (sum.saturated) return SeparationReason::kSaturated;
    if (!(sum.total > options_.min_signal_sigmas * std::sqrt(sum.total_variance))) return SeparationReason::kUnlit;
    const double global_sigma = std::sqrt(sum.direct_variance + sum.total_variance);
    if (sum.total - sum.direct < -options_.negative_sigmas * global_sigma) return SeparationReason::kNegative;
    return SeparationReason::kValid;
  }

  const SeparationFrames& frames_;
  Cfa cfa_;
  const SensorNoise& noise_;
  const SeparationOptions& options_;
  SiteSolver solve_;
};

Status CheckFrames(const SeparationFrames& frames, const std::vector<ImageView<const uint16_t>>& views) {
  const int width = frames.white.width(), height = frames.white.height();
  if (frames.white.empty()) return Status::Usage("separate: the white frame is missing");
  if (frames.black.width() != width || frames.black.height() != height)
    return Status::Usage("separate: the black frame's size differs from the white frame's");
  for (const auto& view : views)
    if (view.width() != width || view.height() != height || view.channels() != 1)
      return Status::Usage("separate: a pattern frame is " + std::to_string(view.width()) + "x" +
                           std::to_string(view.height()) + ", the white frame " + std::to_string(width) + "x" +
                           std::to_string(height));
  return Status::Ok();
}

Separation SeparateAll(const SeparationFrames& frames, Cfa cfa, const SensorNoise& noise,
                       const SeparationOptions& options, SiteSolver solve) {
  const int step = QuadStep(cfa), channels = QuadChannels(cfa);
  const int width = frames.white.width() / step, height = frames.white.height() / step;
  const float nan = std::nanf("");
  const auto unknown = [&] { return Image<float>(width, height, channels, nan); };
  Separation out{{unknown(), unknown(), unknown(), unknown(), Image<uint8_t>(width, height)}, {}};
  const QuadSeparator separator(frames, cfa, noise, options, std::move(solve));
  ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
    for (int64_t j = begin; j < end; ++j)
      for (int i = 0; i < width; ++i) separator.SeparateQuad(i, static_cast<int>(j), out.map);
  });
  for (uint8_t reason : out.map.reason.pixels()) ++out.counts[reason];
  return out;
}

}  // namespace

const char* ToString(SeparationReason reason) {
  constexpr std::array<const char*, kSeparationReasons> kNames = {"valid", "unlit", "saturated", "negative",
                                                                  "not told"};
  return kNames[static_cast<size_t>(reason)];
}

Image<float> ValidDirect(const SeparationMap& map) {
  Image<float> direct = map.direct;
  for (int j = 0; j < direct.height(); ++j)
    for (int i = 0; i < direct.width(); ++i)
      if (map.reason(i, j) != static_cast<uint8_t>(SeparationReason::kValid))
        for (int c = 0; c < direct.channels(); ++c) direct(i, j, c) = std::nanf("");
  return direct;
}

Status SeparationOptions::Validate() const {
  if (!(projector_black >= 0.0) || !(projector_black < 1.0))
    return Status::Usage("separate: projector_black = " + std::to_string(projector_black) + ", allowed: 0 .. below 1");
  if (!(sinusoid_amplitude > 0.0))
    return Status::Usage("separate: sinusoid_amplitude = " + std::to_string(sinusoid_amplitude) + ", allowed: above 0");
  if (!(min_signal_sigmas >= 0.0) || !(negative_sigmas >= 0.0))
    return Status::Usage("separate: thresholds must not be negative");
  return Status::Ok();
}

Result<Separation> SeparateSinusoids(const SeparationFrames& frames, Cfa cfa, const SensorNoise& noise,
                                     const SeparationOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_RETURN_IF_ERROR(CheckFrames(frames, frames.column_shifts));
  SLX_RETURN_IF_ERROR(CheckFrames(frames, frames.row_shifts));
  const size_t columns = frames.column_shifts.size(), rows = frames.row_shifts.size();
  if ((columns == 0 && rows == 0) || columns == 1 || columns == 2 || rows == 1 || rows == 2)
    return Status::Usage("separate: needs at least 3 shifted sinusoids along an axis, has " + std::to_string(columns) +
                         " along columns, " + std::to_string(rows) + " along rows");
  const ShiftTable column_table(static_cast<int>(columns)), row_table(static_cast<int>(rows));
  return SeparateAll(frames, cfa, noise, options, [&](size_t site) {
    return SolveSinusoids(frames, site, noise, options, column_table, row_table);
  });
}

Result<Separation> WhiteAlone(const SeparationFrames& frames, Cfa cfa, const SensorNoise& noise,
                              const SeparationOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_RETURN_IF_ERROR(CheckFrames(frames, {}));
  Separation out =
      SeparateAll(frames, cfa, noise, options, [&](size_t site) { return WhiteLight(frames, site, noise, options); });
  out.counts = {};
  for (size_t quad = 0; quad < out.map.reason.size(); ++quad) {
    uint8_t& reason = out.map.reason.pixels()[quad];
    if (reason == static_cast<uint8_t>(SeparationReason::kValid))
      reason = static_cast<uint8_t>(SeparationReason::kNotTold);
    ++out.counts[reason];
  }
  const Image<float> unknown(out.map.direct.width(), out.map.direct.height(), out.map.direct.channels(), std::nanf(""));
  out.map.direct = out.map.global = out.map.direct_variance = unknown;
  return out;
}

Result<Separation> SeparateCheckerboards(const SeparationFrames& frames, Cfa cfa, const SensorNoise& noise,
                                         const SeparationOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_RETURN_IF_ERROR(CheckFrames(frames, frames.checkerboards));
  if (frames.checkerboards.size() < 2)
    return Status::Usage("separate: needs at least 2 shifted checkerboards, has " +
                         std::to_string(frames.checkerboards.size()));
  return SeparateAll(frames, cfa, noise, options,
                     [&](size_t site) { return SolveCheckerboards(frames, site, noise, options); });
}

}  // namespace stratalux::fit
