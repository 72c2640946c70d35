// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/surface_rim.h"

#include <Eigen/Geometry>
#include <array>
#include <optional>
#include <span>

#include "fitter/reconstruction/one_surface.h"

namespace stratalux::fit {
namespace {

struct Continuation {
  Eigen::Vector3d point, normal;
  int i = 0, j = 0;  // the quad that it continues
};

class Rim {
 public:
  explicit Rim(const SurfaceMap& surface) : surface_(surface) {}

  void Extend(int i, int j, SurfaceMap& out) const {
    std::array<Continuation, 8> found;
    size_t count = 0;
    for (int dy = -1; dy <= 1; ++dy)
      for (int dx = -1; dx <= 1; ++dx)
        if (const auto one = Continue(i, j, dx, dy)) found[count++] = *one;
    const std::span<const Continuation> all(found.data(), count);
    if (all.empty() || !Together(all)) return;
    Eigen::Vector3d point = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::Zero();
    for (const Continuation& one : all) {
      point += one.point / static_cast<double>(count);
      normal += one.normal;
    }
    normal.normalize();
    out.mask(i, j) = 1;
    for (int c = 0; c < 3; ++c) {
      out.point_mm(i, j, c) = static_cast<float>(point[c]);
      out.normal(i, j, c) = static_cast<float>(normal[c]);
    }
  }

 private:
  [[nodiscard]] bool Known(int i, int j) const {
    return i >= 0 && j >= 0 && i < surface_.width() && j < surface_.height() && surface_.mask(i, j) != 0;
  }

  [[nodiscard]] std::optional<Continuation> Continue(int i, int j, int dx, int dy) const {
    if (!Known(i + dx, j + dy) || !Known(i + 2 * dx, j + 2 * dy)) return std::nullopt;
    const Eigen::Vector3d beside = surface_.Point(i + dx, j + dy), behind = surface_.Point(i + 2 * dx, j + 2 * dy),
                          normal = surface_.Normal(i + dx, j + dy);
    const Eigen::Vector3d step = beside - behind, along = step - normal * normal.dot(step);
    if (!OnOneSurface(surface_, i + dx, j + dy, i + 2 * dx, j + 2 * dy) || along.isZero()) return std::nullopt;
    return Continuation{beside + along.normalized() * step.norm(),
                        2.0 * normal - surface_.Normal(i + 2 * dx, j + 2 * dy), i + dx, j + dy};
  }
  [[nodiscard]] bool Together(std::span<const Continuation> all) const {
    for (size_t a = 0; a < all.size(); ++a)
      for (size_t b = 0; b < a; ++b)
        if (!OnOneSurface(surface_, all[a].i, all[a].j, all[b].i, all[b].j)) return false;
    return true;
  }

  const SurfaceMap& surface_;
};

}  // namespace

SurfaceMap WithRim(const SurfaceMap& surface) {
  SurfaceMap out = surface;
  const Rim rim(surface);
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      if (surface.mask(i, j) == 0) rim.Extend(i, j, out);
  return out;
}

}  // namespace stratalux::fit
