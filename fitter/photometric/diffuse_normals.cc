// SPDX-License-Identifier: Apache-2.0
#include "fitter/photometric/diffuse_normals.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"
#include "shared/image/finite_at.h"

namespace stratalux::fit {
namespace {

constexpr double kShare = 0.99;  // of the light, that is gathered
// Of a quad's area at grazing view: beyond, the quad's own normal says less of its tilt than the area changes.
constexpr double kLeastCos = 0.1;
constexpr int kHalves = 64;  // of a quad's side, that are gathered over at most
// Rays of a lens that distorts lie closer together than its focal length says.
constexpr double kLensMargin = 1.25;

class Gatherer {
 public:
  Gatherer(const SurfaceMap& surface, const Image<float>& normal, const CameraCalibration& camera)
      : surface_(surface),
        normal_(normal),
        spacing_(QuadStep(camera.cfa) / std::sqrt(camera.model.fx * camera.model.fy)),
        area_mm2_(surface.width(), surface.height()) {
    for (int j = 0; j < surface.height(); ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) == 0 || !FiniteAt(normal, i, j)) continue;
        // A pixel's solid angle falls as the cube of its ray's cosine to the axis.
        const Eigen::Vector3d point = surface.Point(i, j);
        const double distance = point.norm(), view = std::abs(surface.Normal(i, j).dot(point)) / distance;
        area_mm2_(i, j) =
            static_cast<float>(spacing_ * spacing_ * std::pow(point.z(), 3) / distance / std::max(kLeastCos, view));
      }
  }

  [[nodiscard]] bool Known(int i, int j) const { return area_mm2_(i, j) > 0.0F; }

  [[nodiscard]] Eigen::Vector3d At(int i, int j, int colour, const EnclosedLight& light) const {
    const Eigen::Vector3d own = NormalAt(i, j), here = surface_.Point(i, j);
    const double half_mm = 0.5 * std::sqrt(area_mm2_(i, j));
    const Image<float>& smoothing = surface_.smoothing_quads;
    const double blurred_mm = smoothing.empty() ? 0.0 : 2.0 * half_mm * smoothing(i, j);
    // At radii of k halves; ring k lies between those around it, of area pi half^2 ((k + 1)^2 - (k - 1)^2). First the
    // disc of the quad's own area.
    std::array<double, kHalves + 3> radii_mm, shares;
    radii_mm[0] = 2.0 * half_mm / std::sqrt(std::numbers::pi);
    for (int k = 0; k < kHalves + 2; ++k) radii_mm[k + 1] = k * half_mm;
    if (!light(i, j, colour, blurred_mm, radii_mm, shares)) return own;
    const std::span<const double> enclosed = std::span(shares).subspan(1);
    int last = 1;
    while (last <= kHalves && enclosed[last] < kShare) ++last;
    std::array<double, kHalves + 2> density{};
    density[0] = shares[0] / area_mm2_(i, j);
    for (int k = 1; k < last; ++k)
      density[k] = (enclosed[k + 1] - enclosed[k - 1]) / (4.0 * std::numbers::pi * k * half_mm * half_mm);
    const double reach_mm = (last - 1) * half_mm;
    const int reach = static_cast<int>(kLensMargin * reach_mm / (here.z() * spacing_)) + 1;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (int y = std::max(0, j - reach); y <= std::min(surface_.height() - 1, j + reach); ++y)
      for (int x = std::max(0, i - reach); x <= std::min(surface_.width() - 1, i + reach); ++x) {
        if (!Known(x, y)) continue;
        const Eigen::Vector3d offset = surface_.Point(x, y) - here, there = NormalAt(x, y);
        const double along_mm = offset.dot(own);
        const double across_mm = std::sqrt(std::max(0.0, offset.squaredNorm() - along_mm * along_mm));
        if (across_mm > reach_mm || std::abs(along_mm) > reach_mm || there.dot(own) <= 0.0) continue;
        const double at = across_mm / half_mm;
        const int k = static_cast<int>(at);
        sum += area_mm2_(x, y) * std::lerp(density[k], density[k + 1], at - k) * there;
      }
    return sum.norm() > 0.0 ? sum.normalized() : own;
  }

 private:
  [[nodiscard]] Eigen::Vector3d NormalAt(int i, int j) const {
    return {normal_(i, j, 0), normal_(i, j, 1), normal_(i, j, 2)};
  }

  const SurfaceMap& surface_;
  const Image<float>& normal_;
  double spacing_;         // between the rays of neighbouring quads, at distance 1
  Image<float> area_mm2_;  // of each quad on the surface; 0: not known
};

}  // namespace

Result<Image<float>> DiffuseNormals(const SurfaceMap& surface, const Image<float>& normal, int colours,
                                    const EnclosedLight& light, const CameraCalibration& camera) {
  const int width = surface.width(), height = surface.height();
  if (normal.width() != width || normal.height() != height)
    return Status::Usage("diffuse normals: surface and normals differ in size");
  const Gatherer gatherer(surface, normal, camera);
  Image<float> diffuse(width, height, 3 * colours, std::nanf(""));
  ParallelFor(height, 4, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < width; ++i)
        for (int c = 0; c < colours && gatherer.Known(i, j); ++c) {
          const Eigen::Vector3d n = gatherer.At(i, j, c, light);
          for (int k = 0; k < 3; ++k) diffuse(i, j, 3 * c + k) = static_cast<float>(n[k]);
        }
  });
  return diffuse;
}

Image<float> NormalsOfColour(const Image<float>& diffuse, int colour) {
  Image<float> normal(diffuse.width(), diffuse.height(), 3);
  for (int j = 0; j < normal.height(); ++j)
    for (int i = 0; i < normal.width(); ++i)
      for (int k = 0; k < 3; ++k) normal(i, j, k) = diffuse(i, j, 3 * colour + k);
  return normal;
}

}  // namespace stratalux::fit
