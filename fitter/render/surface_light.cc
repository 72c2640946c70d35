// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/surface_light.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "fitter/render/receiver.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

// The pattern between its pixels; beyond its edge, the edge.
double PatternAt(const Image<float>& pattern, const Eigen::Vector2d& at) {
  const int x = std::clamp(static_cast<int>(std::floor(at.x())), 0, pattern.width() - 2);
  const int y = std::clamp(static_cast<int>(std::floor(at.y())), 0, pattern.height() - 2);
  const double u = std::clamp(at.x() - x, 0.0, 1.0), v = std::clamp(at.y() - y, 0.0, 1.0);
  return (1 - v) * ((1 - u) * pattern(x, y) + u * pattern(x + 1, y)) +
         v * ((1 - u) * pattern(x, y + 1) + u * pattern(x + 1, y + 1));
}

// Nine points of a pixel's footprint, in the light's pixels: one mosaic pixel, two on the diagonal for green. Those
// that the light does not reach are left out.
std::vector<Eigen::Vector2d> LitFootprint(const SurfaceMap& surface, const RigCalibration& rig, const LitSurface& lit,
                                          int i, int j, int channel) {
  const Eigen::Vector3d n = surface.Normal(i, j);
  const Eigen::Vector2d site = QuadCentre(rig.camera.cfa, i, j) + QuadSiteOffset(rig.camera.cfa, channel);
  const double half = channel == 1 && rig.camera.cfa != Cfa::kMono ? 0.66 : 0.33;
  // Rays through neighbouring pixels differ by the same steps, to some 1e-5 of a pixel.
  const auto through = [&](double dx, double dy) -> Eigen::Vector3d {
    const Eigen::Vector3d ray = rig.camera.model.Unproject(site + half * Eigen::Vector2d(dx, dy));
    return ray / ray.z();
  };
  const Eigen::Vector3d centre = through(0, 0), step_x = through(1, 0) - centre, step_y = through(0, 1) - centre;
  std::vector<Eigen::Vector2d> reached;
  for (int k = 0; k < 9; ++k) {
    const Eigen::Vector3d ray = centre + (k % 3 - 1) * step_x + (k / 3 - 1) * step_y;
    const Eigen::Vector3d point = ray * (n.dot(surface.Point(i, j)) / n.dot(ray));
    const auto at = lit.light.ProjectFromCamera(point);
    if (at && lit.light.model.Contains(*at) && !InShadow(lit, *at, point)) reached.push_back(*at);
  }
  return reached;
}

float ReflectanceAt(const ScatteringModel& model, const SurfaceMap& surface, const ProjectorCalibration& light, int i,
                    int j) {
  const Eigen::Vector3d point = surface.Point(i, j);
  const auto angles = ReflectionAngles::Between((light.CentreInCamera() - point).normalized(), -point.normalized(),
                                                surface.Normal(i, j));
  return static_cast<float>(ReflectanceOf(model.reflection, angles, model.eta));
}

}  // namespace

Image<float> SurfaceReflectance(const MixtureMap& map, const SurfaceMap& surface, const ProjectorCalibration& light,
                                int pool) {
  Image<float> reflectance(surface.width(), surface.height(), map.channels, std::nanf(""));
  const size_t lights = map.training_projectors.size();
  const bool known = map.scattering.reflection.Known();
  ParallelFor(reflectance.height(), 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < reflectance.width(); ++i) {
        std::optional<float> of_any_colour;
        for (int c = 0; c < map.channels; ++c) {
          const int64_t profile = map.ProfileOfQuad(i, j, c, pool);
          if (profile < 0 || !map.Fitted(profile)) continue;
          if (known) {
            if (!of_any_colour) of_any_colour = ReflectanceAt(map.scattering, surface, light, i, j);
            reflectance(i, j, c) = *of_any_colour;
            continue;
          }
          float sum = 0.0F;
          for (size_t p = 0; p < lights; ++p) sum += map.surface[profile * lights + p];
          reflectance(i, j, c) = sum / static_cast<float>(lights);
        }
      }
  });
  return reflectance;
}

std::vector<Image<float>> SurfaceIrradiance(const SurfaceMap& surface, const RigCalibration& rig, const LitSurface& lit,
                                            const std::vector<const Image<float>*>& patterns) {
  const int channels = QuadChannels(rig.camera.cfa);
  std::vector<Image<float>> images(patterns.size(), Image<float>(surface.width(), surface.height(), channels));
  ParallelFor(surface.height(), 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) == 0) continue;
        for (int c = 0; c < channels; ++c) {
          const auto footprint = LitFootprint(surface, rig, lit, i, j, c);
          const double white = lit.light.WhiteTargetDn(surface.Point(i, j), surface.Normal(i, j), c, lit.exposure_ms);
          for (size_t k = 0; k < patterns.size(); ++k) {
            double sum = 0.0;
            for (const Eigen::Vector2d& at : footprint) sum += PatternAt(*patterns[k], at);
            images[k](i, j, c) = static_cast<float>(white * sum / 9.0);
          }
        }
      }
  });
  return images;
}

Image<float> ReflectedLight(const Image<float>& reflectance, const Image<float>& irradiance) {
  Image<float> image = irradiance;
  for (size_t i = 0; i < image.size(); ++i) {
    const float reflected = reflectance.pixels()[i] * irradiance.pixels()[i];
    image.pixels()[i] = std::isfinite(reflected) ? reflected : 0.0F;
  }
  return image;
}

int64_t MarkUnfitted(const MixtureMap& map, const SurfaceMap& surface, int pool,
                     std::span<Image<float>* const> images) {
  int64_t incomplete = 0;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      bool complete = true;
      for (int c = 0; c < map.channels; ++c) {
        const int64_t profile = map.ProfileOfQuad(i, j, c, pool);
        if (profile >= 0 && map.Fitted(profile)) continue;
        complete = false;
        for (Image<float>* image : images) (*image)(i, j, c) = std::nanf("");
      }
      incomplete += complete ? 0 : 1;
    }
  return incomplete;
}

}  // namespace stratalux::fit
