// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/surface_light.h"

#include <cmath>
#include <optional>

#include "fitter/render/receiver.h"
#include "shared/base/parallel.h"
#include "shared/geometry/pixel_box.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr int kPartsOfPixel = 4;

// A part of a camera pixel as the light sees it.
struct LitPart {
  PixelShares columns, rows;
};

// Of the pixels of a quad's colour, each as four Gaussians (pixel_box.h), those parts that the light reaches.
std::vector<LitPart> LitParts(const SurfaceMap& surface, const RigCalibration& rig, const LitSurface& lit, int i, int j,
                              std::span<const Eigen::Vector2d> sites) {
  const QuadPlane plane(surface, rig, i, j);
  const double optics = lit.light.line_blur_px, camera = rig.camera.line_blur_px;
  std::vector<LitPart> parts;
  for (const Eigen::Vector2d& in_quad : sites) {
    const Eigen::Vector2d site = QuadCentre(rig.camera.cfa, i, j) + in_quad;
    const auto at = lit.light.ProjectFromCamera(plane.At(site));
    const auto beside = lit.light.ProjectFromCamera(plane.At(site + Eigen::Vector2d(1, 0)));
    const auto below = lit.light.ProjectFromCamera(plane.At(site + Eigen::Vector2d(0, 1)));
    if (!at || !beside || !below) continue;
    const Eigen::Array2d pixel2 = (*beside - *at).array().square() + (*below - *at).array().square();
    const Eigen::Array2d sigma = (optics * optics + (kHalfBoxVariance + camera * camera) * pixel2).sqrt();
    if (!(sigma < static_cast<double>(lit.light.model.width)).all())
      continue;  // edge-on: no plane says what the pixel sees
    for (int y = -1; y <= 1; y += 2)
      for (int x = -1; x <= 1; x += 2) {
        const Eigen::Vector3d point = plane.At(site + kHalfBoxPlace * Eigen::Vector2d(x, y));
        const auto part = lit.light.ProjectFromCamera(point);
        if (!part || !lit.light.model.Contains(*part) || InShadow(lit, *part, point)) continue;
        parts.push_back({{part->x(), sigma[0]}, {part->y(), sigma[1]}});
      }
  }
  return parts;
}

float ReflectanceAt(const ScatteringModel& model, const SurfaceMap& surface, const ProjectorCalibration& light, int i,
                    int j, int64_t place) {
  const Eigen::Vector3d point = surface.Point(i, j);
  const auto angles = ReflectionAngles::Between((light.CentreInCamera() - point).normalized(), -point.normalized(),
                                                surface.Normal(i, j));
  return static_cast<float>(ReflectanceOf(model.reflection, angles, model.eta, model.reflection.gloss.At(place)));
}

}  // namespace

Image<float> SurfaceReflectance(const MixtureMap& map, const SurfaceMap& surface, const ProjectorCalibration& light,
                                int pool) {
  Image<float> reflectance(surface.width(), surface.height(), map.channels, std::nanf(""));
  const bool known = map.scattering.reflection.Known();
  ParallelFor(reflectance.height(), 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < reflectance.width(); ++i) {
        std::optional<float> of_any_colour;
        for (int c = 0; c < map.channels; ++c) {
          const int64_t profile = map.ProfileOfQuad(i, j, c, pool);
          if (profile < 0 || !map.Fitted(profile)) continue;
          if (known) {
            if (!of_any_colour)
              of_any_colour = ReflectanceAt(map.scattering, surface, light, i, j, map.PlaceOf(profile));
            reflectance(i, j, c) = *of_any_colour;
            continue;
          }
          reflectance(i, j, c) = MeanOfLights(map, profile).surface;
        }
      }
  });
  return reflectance;
}

std::vector<Image<float>> SurfaceIrradiance(const SurfaceMap& surface, const RigCalibration& rig, const LitSurface& lit,
                                            std::span<const LitPyramid> lights) {
  const int channels = QuadChannels(rig.camera.cfa);
  std::vector<Image<float>> images(lights.size(), Image<float>(surface.width(), surface.height(), channels));
  const auto sites = QuadSites(rig.camera.cfa);
  ParallelFor(surface.height(), 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) == 0) continue;
        for (int c = 0; c < channels; ++c) {
          const auto parts = LitParts(surface, rig, lit, i, j, sites[c]);
          const double white = lit.light.WhiteTargetDn(surface.Point(i, j), surface.Normal(i, j), c, lit.exposure_ms);
          const double share = white / (kPartsOfPixel * static_cast<double>(sites[c].size()));
          for (size_t k = 0; k < lights.size(); ++k) {
            double sum = 0.0;
            for (const LitPart& part : parts)
              sum += ShownTo(part.columns, part.rows, lights[k].shown, lights[k].shown_lit);
            images[k](i, j, c) = static_cast<float>(share * sum);
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
