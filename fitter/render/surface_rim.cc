// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/surface_rim.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

namespace stratalux::fit {
namespace {

struct Continuation {
  Eigen::Vector3d point, normal;
  double from_depth = 0.0;  // z of the quad that it continues
};

class Rim {
 public:
  explicit Rim(const SurfaceMap& surface) : surface_(surface) {}

  void Extend(int i, int j, SurfaceMap& out) const {
    Eigen::Vector3d point = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::Zero();
    double nearest = std::numeric_limits<double>::infinity(), furthest = 0.0;
    int count = 0;
    for (int dy = -1; dy <= 1; ++dy)
      for (int dx = -1; dx <= 1; ++dx) {
        const auto one = Continue(i, j, dx, dy);
        if (!one) continue;
        ++count;
        point += one->point;
        normal += one->normal;
        nearest = std::min(nearest, one->from_depth);
        furthest = std::max(furthest, one->from_depth);
      }
    if (count == 0 || furthest - nearest > kMaxEdgeMm) return;
    point /= count;
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
    if (std::abs(step.z()) > kMaxEdgeMm || along.isZero()) return std::nullopt;
    return Continuation{beside + along.normalized() * step.norm(),
                        2.0 * normal - surface_.Normal(i + 2 * dx, j + 2 * dy), beside.z()};
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
