// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/mlsss.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <vector>

#include "fitter/mixture/directional_weights.h"
#include "fitter/mixture/scattering_model.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

// One pixel of one colour, ready to receive light.
struct Receiver {
  Eigen::Vector3d point, normal, shift;  // shift: T(omega_i) - T(omega_o), mm per mm of depth, tangential
  double gain = 1.0;
  RefractedDirections directions;
  double footprint2 = 0.0;  // variance of the camera pixel's box on the surface, mm^2
  double pitch_mm = 1.0;    // of the light's pixels on the surface, mean of both axes
  // Variance below which the light's pixels sample a Gaussian too coarsely (0.55 of the longer pitch: 0.5 % of ripple):
  // such layers read the pattern itself.
  double narrowest2 = 0.0;
  Eigen::Vector3d column_per_mm, row_per_mm;  // gradient of the light's pixel coordinates
};

Eigen::Vector3d ShiftVector(ShiftLaw law, const Eigen::Vector3d& omega, const Eigen::Vector3d& n, double eta) {
  const Eigen::Vector3d t = omega / n.dot(omega) - n;
  const double slope = t.norm();
  if (slope < 1e-9) return Eigen::Vector3d::Zero();
  return t / slope * TangentialShift(law, slope, 0.0, eta);
}

std::optional<Receiver> MakeReceiver(const MixtureMap& map, const SurfaceMap& surface, const RigCalibration& rig,
                                     const ProjectorCalibration& light, int i, int j,
                                     const Eigen::Vector2d& site_in_quad) {
  Receiver r;
  r.normal = surface.Normal(i, j);
  const Pinhole& camera = rig.camera.model;
  auto on_plane = [&](const Eigen::Vector2d& pixel) -> Eigen::Vector3d {
    const Eigen::Vector3d ray = camera.Unproject(pixel);
    return ray * (r.normal.dot(surface.Point(i, j)) / r.normal.dot(ray));
  };
  const Eigen::Vector2d site = QuadCentre(rig.camera.cfa, i, j) + site_in_quad;
  r.point = on_plane(site);
  const Eigen::Vector3d in = (light.CentreInCamera() - r.point).normalized(), out = -r.point.normalized();
  const double cos_in = r.normal.dot(in), cos_out = r.normal.dot(out);
  if (cos_in < 0.02 || cos_out < 0.02) return std::nullopt;
  const ScatteringModel& model = map.scattering;
  r.shift =
      ShiftVector(model.shift_law, in, r.normal, model.eta) - ShiftVector(model.shift_law, out, r.normal, model.eta);
  r.gain = AngularGain(model, cos_in);
  r.directions = DirectionsOf(in, out, r.normal, model.eta);
  // Box of one mosaic pixel, 1/12 px^2 an axis.
  const double px = (on_plane(site + Eigen::Vector2d(1, 0)) - r.point).norm(),
               py = (on_plane(site + Eigen::Vector2d(0, 1)) - r.point).norm();
  r.footprint2 = (1.0 / 12.0 + rig.camera.line_blur_px * rig.camera.line_blur_px) * 0.5 * (px * px + py * py);
  // Mean pitch of the light's pixels: distance / focal length, stretched by the tilt along one axis.
  const double distance = (light.CentreInCamera() - r.point).norm();
  r.pitch_mm = distance / std::sqrt(light.model.fx * light.model.fy) / std::sqrt(cos_in);
  r.narrowest2 = std::pow(0.55 * r.pitch_mm, 2) / cos_in;
  const Rigid3& pose = light.camera_from_projector;
  const Eigen::Vector3d in_light = pose.Inverse() * r.point;
  r.column_per_mm =
      light.model.fx / in_light.z() * (pose.rotation * Eigen::Vector3d(1.0, 0.0, -in_light.x() / in_light.z()));
  r.row_per_mm =
      light.model.fy / in_light.z() * (pose.rotation * Eigen::Vector3d(0.0, 1.0, -in_light.y() / in_light.z()));
  return r;
}

// Gaussian weight of a lit sample for a layer; offset projected on the tangent plane.
double Exchange(const Receiver& r, const LitSample& s, const Eigen::Vector3d& centre, double half_inverse2) {
  if (r.normal.dot(s.normal.cast<double>()) < 0.0) return 0.0;
  const Eigen::Vector3d offset = s.point_mm.cast<double>() - centre;
  const double along = offset.dot(r.normal);
  return std::exp(-half_inverse2 * std::max(0.0, offset.squaredNorm() - along * along));
}

constexpr double kReachSigmas = 3.6;
constexpr double kBlockSigmas = 0.95;  // widest block, of sigma
constexpr double kMaxSpread = 0.3;     // of sigma^2; the widest block on skin that faces the light spreads by 0.15
constexpr double kSharpestRadiusMm = 2.0, kReliefMm = 20.0;  // of a face

// Half the size, in the light's pixels, of what lies within `reach` of a point in its tangent plane. Offsets along the
// normal do not count as distance: the surface may leave the plane by reach^2 / 2R, and at most by the face's relief.
double Extent(const Eigen::Vector3d& normal, const Eigen::Vector3d& pixels_per_mm, double reach_mm) {
  const double along = normal.dot(pixels_per_mm);
  const double off_plane_mm = std::min(0.5 * reach_mm * reach_mm / kSharpestRadiusMm, kReliefMm);
  return std::sqrt(std::max(0.0, pixels_per_mm.squaredNorm() - along * along)) * reach_mm +
         std::abs(along) * off_plane_mm;
}

// One layer of one pixel, gathering from the pyramid.
struct Gather {
  const LitPyramid& light;
  Eigen::Vector3f normal, centre;
  float half_inverse2;   // 1 / 2 sigma^2
  float max_spread_mm2;  // blocks that spread wider are opened
  int channel;

  [[nodiscard]] float From(int level, int x, int y) const {
    const LitSample& s = light.levels[level](x, y);
    const float flux = s.flux[channel];
    if (flux == 0.0F) return 0.0F;
    if (s.spread_mm2 > max_spread_mm2) return Opened(level - 1, 2 * x, 2 * y);
    if (normal.dot(s.normal) < 0.0F) return 0.0F;
    const Eigen::Vector3f offset = s.point_mm - centre;
    const float along = offset.dot(normal);
    const float exponent = half_inverse2 * (offset.squaredNorm() - along * along);
    return exponent < 13.0F ? flux * std::exp(-exponent) : 0.0F;
  }
  // A block across an edge of depth, or grazed by the light: its mean is no place on the skin.
  [[nodiscard]] float Opened(int level, int x, int y) const {
    float sum = 0.0F;
    for (int j = y; j < std::min(y + 2, light.levels[level].height()); ++j)
      for (int i = x; i < std::min(x + 2, light.levels[level].width()); ++i) sum += From(level, i, j);
    return sum;
  }
};

// sum of flux K2 over the blocks of one pyramid level within reach.
float GatherLevel(const Receiver& r, const LitPyramid& light, int level, const Eigen::Vector3d& centre,
                  const Eigen::Vector2d& at, double sigma, int channel) {
  const int block = 1 << level;
  const double half_inverse2 = 0.5 / (sigma * sigma), reach = kReachSigmas * sigma;
  const double half_x = Extent(r.normal, r.column_per_mm, reach) / block + 1.0,
               half_y = Extent(r.normal, r.row_per_mm, reach) / block + 1.0;
  const double bx = (at.x() + 0.5) / block - 0.5, by = (at.y() + 0.5) / block - 0.5;
  const Image<LitSample>& blocks = light.levels[level];
  const int x0 = std::max(0, static_cast<int>(std::ceil(bx - half_x))),
            x1 = std::min(blocks.width() - 1, static_cast<int>(std::floor(bx + half_x)));
  const int y0 = std::max(0, static_cast<int>(std::ceil(by - half_y))),
            y1 = std::min(blocks.height() - 1, static_cast<int>(std::floor(by + half_y)));
  const Gather gather{light,
                      r.normal.cast<float>(),
                      centre.cast<float>(),
                      static_cast<float>(half_inverse2),
                      static_cast<float>(kMaxSpread * sigma * sigma),
                      channel};
  const auto [plain, left_out] = GatherBlocks(light.planes[level], x0, x1, y0, y1,
                                              {{gather.normal.x(), gather.normal.y(), gather.normal.z()},
                                               {gather.centre.x(), gather.centre.y(), gather.centre.z()},
                                               gather.half_inverse2,
                                               gather.max_spread_mm2,
                                               channel});
  float sum = plain;
  if (left_out)
    for (int y = y0; y <= y1; ++y)
      for (int x = x0; x <= x1; ++x)
        if (blocks(x, y).spread_mm2 > gather.max_spread_mm2) sum += gather.From(level, x, y);
  return sum * static_cast<float>(half_inverse2 / std::numbers::pi);
}

// The pattern between its pixels; beyond its edge, the edge.
double PatternAt(const Image<float>& pattern, const Eigen::Vector2d& at) {
  const int x = std::clamp(static_cast<int>(std::floor(at.x())), 0, pattern.width() - 2);
  const int y = std::clamp(static_cast<int>(std::floor(at.y())), 0, pattern.height() - 2);
  const double u = std::clamp(at.x() - x, 0.0, 1.0), v = std::clamp(at.y() - y, 0.0, 1.0);
  return (1 - v) * ((1 - u) * pattern(x, y) + u * pattern(x + 1, y)) +
         v * ((1 - u) * pattern(x, y + 1) + u * pattern(x + 1, y + 1));
}

// Something nearer to the light takes it: the light's pixel shows another place.
bool InShadow(const LitSurface& lit, const Eigen::Vector2d& at, const Eigen::Vector3d& point) {
  constexpr double kSamePlaceMm = 3.0;
  const LitSample& s = lit.samples(std::clamp(static_cast<int>(std::lround(at.x())), 0, lit.samples.width() - 1),
                                   std::clamp(static_cast<int>(std::lround(at.y())), 0, lit.samples.height() - 1));
  return s.flux[1] > 0.0F && (point - lit.light.CentreInCamera()).norm() >
                                 (s.point_mm.cast<double>() - lit.light.CentreInCamera()).norm() + kSamePlaceMm;
}

// Shares of a Gaussian (mean, standard deviation in pixels) that fall on pixels first, first + 1, ...
struct PixelShares {
  int first = 0;
  std::vector<double> share;

  PixelShares(double mean, double sigma) {
    const int reach = static_cast<int>(std::ceil(4.0 * sigma + 0.5));
    first = static_cast<int>(std::lround(mean)) - reach;
    auto below = [&](double x) { return 0.5 * std::erfc((mean - x) / (sigma * std::numbers::sqrt2)); };
    double last = below(first - 0.5);
    for (int k = 0; k <= 2 * reach; ++k) {
      const double next = below(first + k + 0.5);
      share.push_back(next - last);
      last = next;
    }
  }
};

// A layer too narrow for the light's pixels to sample it: irradiance times the mean over the layer's Gaussian, blurred
// by the light's optics, of the pattern, whose pixels are boxes, on the tangent plane, where the surface is as good as
// flat. Columns and rows are taken as independent.
double NarrowLayer(const Receiver& r, const LitPyramid& light, const LitSurface& lit, const Eigen::Vector3d& centre,
                   const Eigen::Vector2d& at, double variance, int channel) {
  if (!lit.light.model.Contains(at) || InShadow(lit, at, centre)) return 0.0;
  auto pixels = [&](const Eigen::Vector3d& per_mm) {
    const double along_normal = r.normal.dot(per_mm);
    const double optics = lit.light.line_blur_px;
    return std::sqrt(std::max(per_mm.squaredNorm() - along_normal * along_normal, 1e-12) * variance + optics * optics);
  };
  const PixelShares columns(at.x(), pixels(r.column_per_mm)), rows(at.y(), pixels(r.row_per_mm));
  const Image<float>& pattern = light.shown;
  double sum = 0.0;
  for (size_t j = 0; j < rows.share.size(); ++j) {
    const int y = std::clamp(rows.first + static_cast<int>(j), 0, pattern.height() - 1);
    double row = 0.0;
    for (size_t i = 0; i < columns.share.size(); ++i)
      row += columns.share[i] * pattern(std::clamp(columns.first + static_cast<int>(i), 0, pattern.width() - 1), y);
    sum += rows.share[j] * row;
  }
  return sum * lit.light.WhiteTargetDn(centre, r.normal, channel, lit.exposure_ms);
}

template <typename PixelLight>
Image<float> ForEachPixel(const MixtureMap& map, const SurfaceMap& surface, const RigCalibration& rig,
                          const LitSurface& lit, const RenderOptions& options, const PixelLight& light_of) {
  Image<float> image(surface.width(), surface.height(), map.channels);
  std::vector<std::vector<Eigen::Vector2d>> sites;
  for (int c = 0; c < map.channels; ++c) sites.push_back(QuadSites(rig.camera.cfa, c));
  ParallelFor(surface.height(), 2, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) == 0) continue;
        for (int c = 0; c < map.channels; ++c) {
          const int64_t profile = map.ProfileOfQuad(i, j, c, options.pool);
          if (profile < 0 || !map.Fitted(profile)) continue;
          double sum = 0.0;
          for (const Eigen::Vector2d& site : sites[c])
            if (const auto receiver = MakeReceiver(map, surface, rig, lit.light, i, j, site))
              sum += light_of(*receiver, profile, c);
          image(i, j, c) = static_cast<float>(sum / static_cast<double>(sites[c].size()));
        }
      }
  });
  return image;
}

}  // namespace

Image<float> RenderSubsurface(const MixtureMap& map, const SurfaceMap& surface, const RigCalibration& rig,
                              const LitPyramid& light, const LitSurface& lit, const RenderOptions& options) {
  const int coarsest = static_cast<int>(light.levels.size()) - 1;
  return ForEachPixel(map, surface, rig, lit, options, [&](const Receiver& r, int64_t profile, int c) {
    double sum = 0.0;
    for (int l = 0; l < map.layers; ++l) {
      const size_t at = static_cast<size_t>(profile) * map.layers + l;
      if (!(map.weight[at] > 0.0F)) continue;
      const double own2 = double(map.sigma_mm[at]) * map.sigma_mm[at] + r.footprint2;
      // A block's own extent, h^2 / 12, is part of the width.
      int level = 0;
      while (level < coarsest && r.pitch_mm * (2 << level) < kBlockSigmas * std::sqrt(own2)) ++level;
      const double h = r.pitch_mm * (1 << level);
      const Eigen::Vector3d centre = r.point + map.depth_mm[at] * r.shift;
      const auto pixel = lit.light.ProjectFromCamera(centre);
      if (!pixel) continue;
      const double variance = own2 + h * h / 12.0;
      sum += map.weight[at] *
             DirectionalFactor(map.scattering.directional, r.directions, map.depth_mm[at], map.sigma_mm[at]) *
             (variance < r.narrowest2 ? NarrowLayer(r, light, lit, centre, *pixel, own2, c)
                                      : GatherLevel(r, light, level, centre, *pixel, std::sqrt(variance), c));
    }
    return sum * r.gain;
  });
}

Image<float> RenderSubsurfaceReference(const MixtureMap& map, const SurfaceMap& surface, const RigCalibration& rig,
                                       const LitPyramid& light, const LitSurface& lit, const RenderOptions& options) {
  return ForEachPixel(map, surface, rig, lit, options, [&](const Receiver& r, int64_t profile, int c) {
    double sum = 0.0;
    for (int l = 0; l < map.layers; ++l) {
      const size_t at = static_cast<size_t>(profile) * map.layers + l;
      if (!(map.weight[at] > 0.0F)) continue;
      const double own2 = double(map.sigma_mm[at]) * map.sigma_mm[at] + r.footprint2;
      const double variance = own2 + r.pitch_mm * r.pitch_mm / 12.0;
      const Eigen::Vector3d centre = r.point + map.depth_mm[at] * r.shift;
      double layer = 0.0;
      if (variance < r.narrowest2) {
        const auto pixel = lit.light.ProjectFromCamera(centre);
        if (pixel) layer = NarrowLayer(r, light, lit, centre, *pixel, own2, c);
      } else {
        for (const LitSample& s : light.levels[0].pixels())
          if (s.flux[c] > 0.0F) layer += s.flux[c] * Exchange(r, s, centre, 0.5 / variance);
        layer /= 2.0 * std::numbers::pi * variance;
      }
      sum += map.weight[at] *
             DirectionalFactor(map.scattering.directional, r.directions, map.depth_mm[at], map.sigma_mm[at]) * layer;
    }
    return sum * r.gain;
  });
}

Image<float> SurfaceReflectance(const MixtureMap& map, const SurfaceMap& surface, const ProjectorCalibration& light,
                                int pool) {
  Image<float> reflectance(surface.width(), surface.height(), map.channels, std::nanf(""));
  const size_t lights = map.training_projectors.size();
  for (int j = 0; j < reflectance.height(); ++j)
    for (int i = 0; i < reflectance.width(); ++i)
      for (int c = 0; c < map.channels; ++c) {
        const int64_t profile = map.ProfileOfQuad(i, j, c, pool);
        if (profile < 0 || !map.Fitted(profile)) continue;
        if (map.scattering.reflection.Known()) {
          const Eigen::Vector3d point = surface.Point(i, j);
          const auto angles = ReflectionAngles::Between((light.CentreInCamera() - point).normalized(),
                                                        -point.normalized(), surface.Normal(i, j));
          reflectance(i, j, c) =
              static_cast<float>(ReflectanceOf(map.scattering.reflection, angles, map.scattering.eta));
          continue;
        }
        float sum = 0.0F;
        for (size_t p = 0; p < lights; ++p) sum += map.surface[profile * lights + p];
        reflectance(i, j, c) = sum / static_cast<float>(lights);
      }
  return reflectance;
}

Image<float> RenderSurface(ImageView<const float> reflectance, const SurfaceMap& surface, const RigCalibration& rig,
                           const LitPyramid& light, const LitSurface& lit) {
  Image<float> image(surface.width(), surface.height(), reflectance.channels());
  const Pinhole& camera = rig.camera.model;
  ParallelFor(surface.height(), 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) == 0) continue;
        const Eigen::Vector3d n = surface.Normal(i, j);
        for (int c = 0; c < reflectance.channels(); ++c) {
          // Nine points of the footprint: one mosaic pixel, two on the diagonal for green.
          const Eigen::Vector2d site = QuadCentre(rig.camera.cfa, i, j) + QuadSiteOffset(rig.camera.cfa, c);
          const double half = c == 1 && rig.camera.cfa != Cfa::kMono ? 0.66 : 0.33;
          double sum = 0.0;
          for (int k = 0; k < 9; ++k) {
            const Eigen::Vector3d ray = camera.Unproject(site + half * Eigen::Vector2d(k % 3 - 1, k / 3 - 1));
            const Eigen::Vector3d point = ray * (n.dot(surface.Point(i, j)) / n.dot(ray));
            const auto at = lit.light.ProjectFromCamera(point);
            if (!at || !lit.light.model.Contains(*at) || InShadow(lit, *at, point)) continue;
            sum += PatternAt(light.pattern, *at);
          }
          const double white = lit.light.WhiteTargetDn(surface.Point(i, j), n, c, lit.exposure_ms);
          const float reflected = static_cast<float>(reflectance(i, j, c) * white * sum / 9.0);
          image(i, j, c) = std::isfinite(reflected) ? reflected : 0.0F;
        }
      }
  });
  return image;
}

}  // namespace stratalux::fit
