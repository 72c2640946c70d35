// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/truth_normals.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::rig {
namespace {

constexpr double kNearestMm = 0.02, kFarthestMm = 12.0;
constexpr int kRadii = 80;
const double kRatio = std::pow(kFarthestMm / kNearestMm, 1.0 / (kRadii - 1));

// Light of a kernel within a radius, in the kernel's units.
class EnclosedLight {
 public:
  explicit EnclosedLight(const SkinKernel& kernel) {
    static const std::array<SkinKernel::RadialWeights, kRadii> kWithin = [] {
      std::array<SkinKernel::RadialWeights, kRadii> within;
      for (int m = 0; m < kRadii; ++m)
        within[m] = SkinKernel::WeightsOf(
            [limit = kNearestMm * std::pow(kRatio, m)](double r_mm) { return r_mm < limit ? 1.0 : 0.0; });
      return within;
    }();
    for (int m = 0; m < kRadii; ++m) within_[m] = kernel.Integral(kWithin[m]);
  }
  [[nodiscard]] double operator()(double radius_mm) const {
    if (radius_mm <= kNearestMm) return within_[0] * std::max(0.0, radius_mm) / kNearestMm;
    const double at = std::log(radius_mm / kNearestMm) / std::log(kRatio);
    const int m = std::min(static_cast<int>(at), kRadii - 2);
    const double f = std::min(at - m, 1.0);
    return (1.0 - f) * within_[m] + f * within_[m + 1];
  }

 private:
  std::array<double, kRadii> within_{};
};

class Gatherer {
 public:
  Gatherer(const SeenSurface& seen, const Pinhole& camera, Cfa cfa)
      : seen_(seen), spacing_(QuadStep(cfa) / std::sqrt(camera.fx * camera.fy)) {}

  [[nodiscard]] Eigen::Vector3d At(int i, int j, const SkinKernel& kernel) const {
    const Eigen::Vector3d here = VectorAt(seen_.point_mm, i, j), own = VectorAt(seen_.normal, i, j);
    const double side_mm = std::sqrt(AreaMm2(i, j));
    const EnclosedLight within(kernel);
    // Of quads in rings of half a quad's side to either side; of the quad itself, of its own area.
    const auto density = [&](double r_mm) {
      if (r_mm == 0.0) return within(side_mm / std::sqrt(std::numbers::pi)) / (side_mm * side_mm);
      const double inner = std::max(0.0, r_mm - 0.5 * side_mm), outer = r_mm + 0.5 * side_mm;
      return (within(outer) - within(inner)) / (std::numbers::pi * (outer * outer - inner * inner));
    };
    std::array<double, 128> of_ring;  // evenly in the radius
    const double step_mm = kFarthestMm / (of_ring.size() - 1);
    for (size_t k = 0; k < of_ring.size(); ++k) of_ring[k] = density(std::max(1e-6, step_mm * static_cast<double>(k)));
    Eigen::Vector3d sum = AreaMm2(i, j) * density(0.0) * own;
    const int reach = static_cast<int>(kFarthestMm / (here.z() * spacing_)) + 1;
    for (int y = std::max(0, j - reach); y <= std::min(seen_.normal.height() - 1, j + reach); ++y)
      for (int x = std::max(0, i - reach); x <= std::min(seen_.normal.width() - 1, i + reach); ++x) {
        if ((x == i && y == j) || !seen_.material(x, y).Translucent()) continue;
        const double r_mm = (VectorAt(seen_.point_mm, x, y) - here).norm();
        const Eigen::Vector3d there = VectorAt(seen_.normal, x, y);
        if (r_mm >= kFarthestMm || there.dot(own) <= 0.0) continue;
        const double at = r_mm / step_mm;
        const auto k = std::min(static_cast<size_t>(at), of_ring.size() - 2);
        const double f = at - static_cast<double>(k);
        sum += AreaMm2(x, y) * ((1.0 - f) * of_ring[k] + f * of_ring[k + 1]) * there;
      }
    return sum.normalized();
  }

  static Eigen::Vector3d VectorAt(const Image<float>& map, int i, int j) {
    return {map(i, j, 0), map(i, j, 1), map(i, j, 2)};
  }

 private:
  // Of a quad on the surface; edge-on ones are no larger than a tenth of their cosine says.
  [[nodiscard]] double AreaMm2(int i, int j) const {
    const Eigen::Vector3d point = VectorAt(seen_.point_mm, i, j);
    const double distance = point.norm(),
                 view = std::max(0.1, std::abs(VectorAt(seen_.normal, i, j).dot(point)) / distance);
    return spacing_ * spacing_ * std::pow(point.z(), 3) / (distance * view);
  }

  const SeenSurface& seen_;
  double spacing_;  // between the rays of neighbouring quads, at distance 1
};

}  // namespace

Image<float> DiffuseNormals(const SeenSurface& seen, const SkinTable& table, const Pinhole& camera, Cfa cfa) {
  const int width = seen.normal.width(), height = seen.normal.height(), colours = QuadChannels(cfa);
  const Gatherer gatherer(seen, camera, cfa);
  Image<float> diffuse(width, height, 3 * colours, std::nanf(""));
  ParallelFor(height, 2, [&](int64_t begin, int64_t end) {
    SkinKernel kernel;
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < width; ++i)
        for (int c = 0; c < colours && seen.material(i, j).kind != MaterialKind::kNone; ++c) {
          Eigen::Vector3d n = Gatherer::VectorAt(seen.normal, i, j);
          if (seen.material(i, j).Translucent()) {
            table.Interpolate(c, seen.material(i, j).skin, {}, kernel);
            n = gatherer.At(i, j, kernel);
          }
          for (int k = 0; k < 3; ++k) diffuse(i, j, 3 * c + k) = static_cast<float>(n[k]);
        }
  });
  return diffuse;
}

}  // namespace stratalux::rig
