// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/measured_surface.h"

#include <array>
#include <cmath>
#include <numbers>

#include "fitter/mixture/directional_weights.h"
#include "fitter/mixture/shift_law.h"
#include "fitter/separation/shrink_noise.h"
#include "fitter/srd/srd_extractor.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr int kReach = 3;  // quads on either side that noise is shrunk towards

// What the sinusoids along one axis show of a pixel, as shares of its irradiance: contrast of the very surface, and
// light of the layers, sum w exp(-2 pi^2 sigma^2 / period^2), seen with that contrast.
struct SinusoidContrast {
  double surface = 0.0, layers = 0.0;
};

// `g`: of the axis, at the site of red: the amplitude is taken site by site, so the blur of a single site counts, also
// for the two greens.
SinusoidContrast ContrastOf(const SrdGeometry& g, const RefractedDirections& directions, double separation_period,
                            const MixtureMap& map, int64_t profile) {
  const double wave = 2.0 * std::numbers::pi / (separation_period * g.mm_per_column);
  const double half_pixel = std::numbers::pi / separation_period;  // the projector's pixels are boxes
  const double seen = std::sin(half_pixel) / half_pixel * std::exp(-0.5 * wave * wave * g.blur_mm * g.blur_mm);
  double narrow = 0.0;
  for (int l = 0; l < map.layers; ++l) {
    const size_t at = static_cast<size_t>(profile) * map.layers + l;
    const double sigma = map.sigma_mm[at];
    narrow += map.weight[at] * DirectionalFactor(map.directional, directions, map.depth_mm[at], sigma) *
              std::exp(-0.5 * wave * wave * sigma * sigma);
  }
  return {seen, seen * narrow * (map.gain_model ? AngularGain(g.cos_in, map.eta, map.tau) : 1.0)};
}

// A pixel under the held-out light.
struct LitQuad {
  SrdGeometry columns, rows;  // at the site of red
  RefractedDirections directions;
  std::array<double, 3> white_dn{};  // E of each colour
  double predicted = 0.0;            // by the fit's own surface reflection
};

LitQuad LookAt(const HoldOutInput& in, const MixtureMap& map, int i, int j) {
  const RigCalibration& rig = *in.frames.calibration();
  const Eigen::Vector3d point = in.surface.Point(i, j), normal = in.surface.Normal(i, j);
  const auto geometry_of = [&](int channel, PatternAxis axis) {
    return ComputeSrdGeometry(rig, in.projector, point, normal, QuadCentre(rig.camera.cfa, i, j), channel,
                              in.frames.plan()->exposure_ms, axis);
  };
  const Eigen::Vector3d to_lamp = (rig.projectors[in.projector].CentreInCamera() - point).normalized(),
                        to_eye = -point.normalized();
  LitQuad quad{geometry_of(0, PatternAxis::kColumns),
               geometry_of(0, PatternAxis::kRows),
               DirectionsOf(to_lamp, to_eye, normal, map.eta),
               {},
               0.0};
  for (int c = 0; c < map.channels; ++c) quad.white_dn[c] = geometry_of(c, PatternAxis::kColumns).white_dn;
  quad.predicted = ReflectanceOf(map.reflection, ReflectionAngles::Between(to_lamp, to_eye, normal), map.eta);
  return quad;
}

struct Reflectances {
  Image<float> measured, variance, predicted;
};

void Measure(const HoldOutInput& in, const MixtureMap& map, int i, int j, Reflectances& out) {
  const SeparationMap& separation = in.face.separation[in.projector];
  const LitQuad quad = LookAt(in, map, i, j);
  if (!(quad.columns.white_dn > 0.0) || !(quad.rows.white_dn > 0.0)) return;
  const double period = in.frames.plan()->separation_period;
  for (int c = 0; c < map.channels; ++c) {
    const int64_t profile = map.ProfileIndex(i / in.pool, j / in.pool, c);
    if (!map.Fitted(profile) || !(quad.white_dn[c] > 0.0)) continue;
    const SinusoidContrast across = ContrastOf(quad.columns, quad.directions, period, map, profile),
                           along = ContrastOf(quad.rows, quad.directions, period, map, profile);
    const double surface = across.surface + along.surface, per_dn = 2.0 / quad.white_dn[c];
    out.measured(i, j, c) =
        static_cast<float>((per_dn * separation.direct(i, j, c) - across.layers - along.layers) / surface);
    out.variance(i, j, c) =
        static_cast<float>(separation.direct_variance(i, j, c) * (per_dn / surface) * (per_dn / surface));
    out.predicted(i, j, c) = static_cast<float>(quad.predicted);
  }
}

}  // namespace

Image<float> MeasuredSurface(const HoldOutInput& in, const MixtureMap& map) {
  const int width = in.surface.width(), height = in.surface.height();
  const Image<float> unknown(width, height, map.channels, std::nanf(""));
  Reflectances seen{unknown, unknown, unknown};
  ParallelFor(height, 4, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < width; ++i)
        if (in.surface.mask(i, j) != 0 && i / in.pool < map.width && j / in.pool < map.height)
          Measure(in, map, i, j, seen);
  });
  // Neighbours share what the prediction misses rather than the slopes of a highlight.
  for (size_t k = 0; k < seen.measured.size(); ++k) seen.measured.pixels()[k] -= seen.predicted.pixels()[k];
  Image<float> reflectance = ShrinkNoise(seen.measured, seen.variance, kReach);
  for (size_t k = 0; k < reflectance.size(); ++k) reflectance.pixels()[k] += seen.predicted.pixels()[k];
  return reflectance;
}

}  // namespace stratalux::fit
