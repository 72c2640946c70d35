// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/direct_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <functional>
#include <numbers>
#include <optional>

#include "fitter/mixture/scattering_model.h"
#include "fitter/separation/shrink_noise.h"
#include "fitter/srd/srd_extractor.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr int kReach = 3;  // quads on either side that noise is shrunk towards
// Contrast of both axes' sinusoids together below which they tell no light: of pixels as long as a period.
constexpr double kLeastSeen = 0.05;

constexpr std::array<PatternAxis, 2> kAxes = {PatternAxis::kColumns, PatternAxis::kRows};

// A quad under the light. Contrast is taken at the site of red: the amplitude is found site by site, so the blur of a
// single site counts, also for the two greens.
struct LitQuad {
  std::array<SrdGeometry, 2> axes;  // columns, rows
  std::array<double, 2> surface{};  // contrast of the surface itself under the sinusoids of that axis
};

SrdGeometry GeometryOf(const HeldOutLight& light, const SurfaceMap& surface, int i, int j, int channel,
                       PatternAxis axis) {
  return ComputeSrdGeometry(light.rig, light.projector, surface.Point(i, j), surface.Normal(i, j),
                            QuadCentre(light.rig.camera.cfa, i, j), channel, light.exposure_ms, axis);
}

std::optional<LitQuad> LookAt(const HeldOutLight& light, const SurfaceMap& surface, int i, int j) {
  if (surface.mask(i, j) == 0) return std::nullopt;
  LitQuad quad;
  for (size_t a = 0; a < 2; ++a) {
    const SrdGeometry& g = quad.axes[a] = GeometryOf(light, surface, i, j, 0, kAxes[a]);
    if (!(g.white_dn > 0.0)) return std::nullopt;
    const double wave = 2.0 * std::numbers::pi / (light.separation_period * g.mm_per_column);
    const double half_pixel = std::numbers::pi / light.separation_period;  // the projector's pixels are boxes
    quad.surface[a] = std::sin(half_pixel) / half_pixel * std::exp(-0.5 * wave * wave * g.blur_mm * g.blur_mm) *
                      std::abs(std::cos(wave * g.box_x_mm) * std::cos(wave * g.box_y_mm));
  }
  if (quad.surface[0] + quad.surface[1] < kLeastSeen) return std::nullopt;
  return quad;
}

// What a profile's layers add to the amplitude of the sinusoids, seen with the contrast of the surface itself, beyond
// what the surface of `reflectance` shows by itself: |R + sum w exp(-2 pi^2 sigma^2 / period^2 + 2 pi i d s / period)|
// - R, as a share of the irradiance; both axes together. A layer of depth d is displaced by d s and out of the
// surface's phase.
double ResolvedLayers(const LitQuad& quad, double period, const RefractedDirections& directions, const MixtureMap& map,
                      int64_t profile, double reflectance) {
  const ScatteringModel& model = map.scattering;
  std::array<double, 2> wave{}, shift{};
  for (size_t a = 0; a < 2; ++a) {
    const SrdGeometry& g = quad.axes[a];
    wave[a] = 2.0 * std::numbers::pi / (period * g.mm_per_column);
    shift[a] = TangentialShift(model.shift_law, g.slope_in, g.slope_in_across, model.eta) -
               TangentialShift(model.shift_law, g.slope_out, g.slope_out_across, model.eta);
  }
  std::array<std::complex<double>, 2> narrow{};
  for (int l = 0; l < map.layers; ++l) {
    const size_t at = static_cast<size_t>(profile) * map.layers + l;
    const double sigma = map.sigma_mm[at], weight = map.weight[at], depth = map.depth_mm[at];
    if (!(weight > 0.0)) continue;
    const double light = weight * DirectionalFactor(model.directional, directions, depth, sigma);
    for (size_t a = 0; a < 2; ++a)
      narrow[a] += std::polar(light * std::exp(-0.5 * wave[a] * wave[a] * sigma * sigma), wave[a] * depth * shift[a]);
  }
  double resolved = 0.0;
  for (size_t a = 0; a < 2; ++a)
    resolved +=
        quad.surface[a] * (std::abs(reflectance + AngularGain(model, quad.axes[a].cos_in) * narrow[a]) - reflectance);
  return resolved;
}

void ForEachQuad(const SurfaceMap& surface, const std::function<void(int i, int j)>& look) {
  ParallelFor(surface.height(), 4, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < surface.width(); ++i) look(i, j);
  });
}

}  // namespace

Image<float> DirectReflectance(const HeldOutLight& light, const SurfaceMap& surface, ImageView<const uint8_t> lit,
                               const SeparationMap& separation) {
  const int channels = separation.direct.channels();
  Image<float> direct(surface.width(), surface.height(), channels, std::nanf("")), variance = direct;
  ForEachQuad(surface, [&](int i, int j) {
    const auto quad = lit(i, j) != 0 ? LookAt(light, surface, i, j) : std::nullopt;
    if (!quad) return;
    for (int c = 0; c < channels; ++c) {
      const double white_dn = GeometryOf(light, surface, i, j, c, PatternAxis::kColumns).white_dn;
      if (!(white_dn > 0.0)) continue;
      const double scale = 2.0 / (white_dn * (quad->surface[0] + quad->surface[1]));
      const bool told = std::isfinite(separation.direct(i, j, c));
      direct(i, j, c) = told ? static_cast<float>(separation.direct(i, j, c) * scale) : 0.0F;
      variance(i, j, c) = told ? static_cast<float>(separation.direct_variance(i, j, c) * scale * scale) : INFINITY;
    }
  });
  return ShrinkNoise(direct, variance, kReach);
}

Image<float> DirectShare(const HeldOutLight& light, const SurfaceMap& surface, const MixtureMap& map,
                         const Image<float>& reflectance, int pool) {
  Image<float> share(surface.width(), surface.height(), map.channels, std::nanf(""));
  ForEachQuad(surface, [&](int i, int j) {
    const auto quad = LookAt(light, surface, i, j);
    if (!quad) return;
    const Eigen::Vector3d point = surface.Point(i, j);
    const RefractedDirections directions =
        DirectionsOf((light.rig.projectors[light.projector].CentreInCamera() - point).normalized(), -point.normalized(),
                     surface.Normal(i, j), map.scattering.eta);
    for (int c = 0; c < map.channels; ++c) {
      const int64_t profile = map.ProfileOfQuad(i, j, c, pool);
      if (profile < 0 || !map.Fitted(profile)) continue;
      const double surface_reflects = std::isfinite(reflectance(i, j, c)) ? std::max(0.0F, reflectance(i, j, c)) : 0.0F;
      const double resolved =
          ResolvedLayers(*quad, light.separation_period, directions, map, profile, surface_reflects);
      share(i, j, c) = static_cast<float>(resolved / (quad->surface[0] + quad->surface[1]));
    }
  });
  return share;
}

}  // namespace stratalux::fit
