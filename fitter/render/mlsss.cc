// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/mlsss.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "fitter/mixture/scattering_model.h"
#include "fitter/render/receiver.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr double kReachSigmas = 3.6;
constexpr double kBlockSigmas = 0.95;  // widest block, of sigma
constexpr double kMaxSpread = 0.3;     // of sigma^2; the widest block on skin that faces the light spreads by 0.15

// A layer of one colour at one of its sites, as it gathers from a level of the pyramid of any pattern.
struct WideLayer {
  int channel = 0;
  BlockWindow window;
  GatherTarget target;
  double factor = 0.0;  // of the Gaussian sum
};
// Those of one level: all that they gather from, and how wide a block may spread for the narrowest of them.
struct LevelLayers {
  std::vector<WideLayer> layers;
  BlockWindow window;
  float max_spread_mm2 = 0.0F;

  void Clear() {
    layers.clear();
    window = {};
    max_spread_mm2 = std::numeric_limits<float>::infinity();
  }
};
// A layer where it reads the pattern itself.
struct ReadLayer {
  int channel = 0;
  NarrowLayer pixels;
  double factor = 0.0;  // of the light read
};

// Blocks of a level within reach of a pixel of the light.
class BlockReach {
 public:
  explicit BlockReach(const Receiver& r) : columns_per_mm_(r.column_per_mm.norm()), rows_per_mm_(r.row_per_mm.norm()) {}

  [[nodiscard]] BlockWindow Of(const LitPlanes& blocks, int level, const Eigen::Vector2d& at, double sigma) const {
    const int block = 1 << level;
    const double reach = kReachSigmas * sigma;
    const double half_x = columns_per_mm_ * reach / block + 1.0, half_y = rows_per_mm_ * reach / block + 1.0;
    const double bx = (at.x() + 0.5) / block - 0.5, by = (at.y() + 0.5) / block - 0.5;
    return {std::max(0, static_cast<int>(std::ceil(bx - half_x))),
            std::min(blocks.width - 1, static_cast<int>(std::floor(bx + half_x))),
            std::max(0, static_cast<int>(std::ceil(by - half_y))),
            std::min(blocks.height - 1, static_cast<int>(std::floor(by + half_y)))};
  }

 private:
  double columns_per_mm_, rows_per_mm_;  // in the direction in which they rise fastest
};

// Blocks across an edge of depth, or grazed by the light: their mean is no place on the skin, so their parts take their
// place.
class BlockOpener {
 public:
  BlockOpener(const LitPyramid& light, const TangentPlane& plane, float max_spread_mm2, SeenBlocks& seen)
      : light_(light),
        origin_(plane.origin_mm.data()),
        normal_(plane.normal.data()),
        p_(plane.p.data()),
        q_(plane.q.data()),
        max_spread_mm2_(max_spread_mm2),
        seen_(seen) {}

  void Open(int level) {
    for (const auto& [x, y] : seen_.wide) AddPartsOf(level, x, y);
    seen_.EndParts();
  }

 private:
  void AddPartsOf(int level, int x, int y) {
    const LitPlanes& parts = light_.levels[level - 1];
    for (int j = 2 * y; j < std::min(2 * y + 2, parts.height); ++j)
      for (int i = 2 * x; i < std::min(2 * x + 2, parts.width); ++i) Add(level - 1, i, j);
  }
  void Add(int level, int x, int y) {
    const LitPlanes& blocks = light_.levels[level];
    const size_t at = static_cast<size_t>(y) * blocks.stride + x;
    if (blocks.flux[at] == 0.0F) return;
    if (blocks.spread_mm2[at] > max_spread_mm2_) return AddPartsOf(level, x, y);
    if (normal_.dot(Eigen::Vector3f(blocks.nx[at], blocks.ny[at], blocks.nz[at])) < 0.0F) return;
    const Eigen::Vector3f offset = Eigen::Vector3f(blocks.x[at], blocks.y[at], blocks.z[at]) - origin_;
    seen_.AddPart(p_.dot(offset), q_.dot(offset), normal_.dot(offset), blocks.flux[at]);
  }

  const LitPyramid& light_;
  const Eigen::Vector3f origin_, normal_, p_, q_;
  const float max_spread_mm2_;
  SeenBlocks& seen_;
};

// All layers of a quad, whichever pattern lights it: where they gather, and by how much. Its light under a pattern is a
// sum over blocks that all of its layers, colours and sites see from the same tangent plane.
class QuadLayers {
 public:
  QuadLayers(const MixtureMap& map, const LitSurface& lit, const LitPyramid& any) : map_(map), lit_(lit), any_(any) {
    const auto& white = lit.light.white_dn_mm2_per_ms;
    for (int c = 0; c < 3; ++c) share_[c] = white[any.colour] > 0.0 ? white[c] / white[any.colour] : 0.0;
  }

  void Begin(const Eigen::Vector3d& point, const Eigen::Vector3d& normal) {
    levels_.resize(any_.levels.size());
    for (LevelLayers& level : levels_) level.Clear();
    narrow_.clear();
    origin_ = point;
    normal_ = normal;
    axes_ = {normal.unitOrthogonal(), normal.cross(normal.unitOrthogonal())};
  }

  // The layers of `profile` at a site; `share`: of the colour's light.
  void Add(const Receiver& r, int64_t profile, int channel, double share) {
    const BlockReach reach(r);
    for (int l = 0; l < map_.layers; ++l) {
      const size_t at = static_cast<size_t>(profile) * map_.layers + l;
      if (map_.weight[at] > 0.0F) AddLayer(r, reach, at, channel, share * r.gain * map_.weight[at]);
    }
  }

  // Light of the quad's layers under a pattern, by colour.
  [[nodiscard]] std::array<double, 3> Under(const LitPyramid& light, SeenBlocks& seen) const {
    std::array<double, 3> sums{};
    const TangentPlane plane = Plane();
    for (size_t level = 0; level < levels_.size(); ++level) {
      const LevelLayers& of = levels_[level];
      const BlockWindow& lit = light.levels[level].lit;  // little of the skin, under a stripe or a spot
      const BlockWindow all = of.window.Within(lit);
      if (all.Empty()) continue;
      SeeBlocks(light.levels[level], all, plane, of.max_spread_mm2, seen);
      if (seen.dark) continue;
      BlockOpener(light, plane, of.max_spread_mm2, seen).Open(static_cast<int>(level));
      for (const WideLayer& layer : of.layers) {
        const BlockWindow window = layer.window.Within(lit);
        if (!window.Empty()) sums[layer.channel] += layer.factor * GatherBlocks(seen, window, layer.target);
      }
    }
    for (const ReadLayer& layer : narrow_)
      sums[layer.channel] += layer.factor * layer.pixels.Under(light.shown, light.shown_lit);
    return sums;
  }

 private:
  void AddLayer(const Receiver& r, const BlockReach& reach, size_t at, int channel, double weight) {
    const double depth = map_.depth_mm[at], width = map_.sigma_mm[at], own2 = width * width + r.footprint2;
    // A block's own extent, h^2 / 12, is part of the width.
    const int coarsest = static_cast<int>(any_.levels.size()) - 1;
    int level = 0;
    while (level < coarsest && r.pitch_mm * (2 << level) < kBlockSigmas * std::sqrt(own2)) ++level;
    const double h = r.pitch_mm * (1 << level);
    const auto pixel = lit_.light.model.Project(r.point_in_light + depth * r.shift_in_light);
    if (!pixel) return;
    const Eigen::Vector3d centre = r.point + depth * r.shift;
    const double variance = own2 + h * h / 12.0,
                 factor = weight * DirectionalFactor(map_.scattering.directional, r.directions, depth, width);
    if (variance < r.narrowest2) {
      narrow_.push_back({channel, NarrowLayer(r, lit_, centre, *pixel, own2, channel), factor});
      return;
    }
    LevelLayers& of = levels_[level];
    const BlockWindow window = reach.Of(any_.levels[level], level, *pixel, std::sqrt(variance));
    of.window = of.window.With(window);
    of.max_spread_mm2 = std::min(of.max_spread_mm2, static_cast<float>(kMaxSpread * variance));
    const Eigen::Vector3d offset = centre - origin_;
    of.layers.push_back({channel,
                         window,
                         {static_cast<float>(offset.dot(axes_[0])), static_cast<float>(offset.dot(axes_[1])),
                          static_cast<float>(0.5 / variance)},
                         factor * share_[channel] / (2.0 * std::numbers::pi * variance)});
  }

  [[nodiscard]] TangentPlane Plane() const {
    const auto of = [](const Eigen::Vector3d& v) {
      return std::array{static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
    };
    return {of(origin_), of(normal_), of(axes_[0]), of(axes_[1])};
  }

  const MixtureMap& map_;
  const LitSurface& lit_;
  const LitPyramid& any_;          // the patterns' pyramids are alike but for their light
  std::array<double, 3> share_{};  // flux of a colour over that of the planes
  Eigen::Vector3d origin_, normal_;
  std::array<Eigen::Vector3d, 2> axes_;
  std::vector<LevelLayers> levels_;
  std::vector<ReadLayer> narrow_;
};

// Gaussian weight of a lit sample for a layer.
double Exchange(const Receiver& r, const LitSample& s, const Eigen::Vector3d& centre, double half_inverse2) {
  if (r.normal.dot(s.normal.cast<double>()) < 0.0) return 0.0;
  return std::exp(-half_inverse2 * (s.point_mm.cast<double>() - centre).squaredNorm());
}

template <typename PixelLight>
Image<float> ForEachPixel(const MixtureMap& map, const SurfaceMap& surface, const RigCalibration& rig,
                          const LitSurface& lit, const RenderOptions& options, const PixelLight& light_of) {
  Image<float> image(surface.width(), surface.height(), map.channels);
  const auto sites = QuadSites(rig.camera.cfa);
  ParallelFor(surface.height(), 2, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) == 0) continue;
        for (int c = 0; c < map.channels; ++c) {
          const int64_t profile = map.ProfileOfQuad(i, j, c, options.pool);
          if (profile < 0 || !map.Fitted(profile)) continue;
          double sum = 0.0;
          for (const PixelPart& part : PixelParts(surface, rig, lit.light, i, j, sites[c]))
            if (const auto receiver = MakeReceiver(map.scattering, surface, rig, lit.light, i, j, part))
              sum += part.share * light_of(*receiver, profile, c);
          image(i, j, c) = static_cast<float>(sum);
        }
      }
  });
  return image;
}

}  // namespace

std::vector<Image<float>> RenderSubsurface(const MixtureMap& map, const SurfaceMap& surface, const RigCalibration& rig,
                                           const LitSurface& lit, std::span<const LitPyramid> lights,
                                           const RenderOptions& options) {
  std::vector<Image<float>> images(lights.size(), Image<float>(surface.width(), surface.height(), map.channels));
  if (lights.empty()) return images;
  const auto sites = QuadSites(rig.camera.cfa);
  ParallelFor(surface.height(), 2, [&](int64_t begin, int64_t end) {
    QuadLayers layers(map, lit, lights.front());
    SeenBlocks seen;
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) == 0) continue;
        layers.Begin(surface.Point(i, j), surface.Normal(i, j));
        for (int c = 0; c < map.channels; ++c) {
          const int64_t profile = map.ProfileOfQuad(i, j, c, options.pool);
          if (profile < 0 || !map.Fitted(profile)) continue;
          for (const PixelPart& part : PixelParts(surface, rig, lit.light, i, j, sites[c]))
            if (const auto receiver = MakeReceiver(map.scattering, surface, rig, lit.light, i, j, part))
              layers.Add(*receiver, profile, c, part.share);
        }
        for (size_t k = 0; k < lights.size(); ++k) {
          const auto light = layers.Under(lights[k], seen);
          for (int c = 0; c < map.channels; ++c) images[k](i, j, c) = static_cast<float>(light[c]);
        }
      }
  });
  return images;
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
        if (pixel) layer = NarrowLayer(r, lit, centre, *pixel, own2, c).Under(light.shown, light.shown_lit);
      } else {
        for (size_t k = 0; k < lit.samples.size(); ++k)
          if (const float shown = light.pattern.pixels()[k]; shown > 0.0F && lit.samples.pixels()[k].flux[c] > 0.0F)
            layer += double{shown} * lit.samples.pixels()[k].flux[c] *
                     Exchange(r, lit.samples.pixels()[k], centre, 0.5 / variance);
        layer /= 2.0 * std::numbers::pi * variance;
      }
      sum += map.weight[at] *
             DirectionalFactor(map.scattering.directional, r.directions, map.depth_mm[at], map.sigma_mm[at]) * layer;
    }
    return sum * r.gain;
  });
}

}  // namespace stratalux::fit
