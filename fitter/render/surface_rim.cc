// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/surface_rim.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

namespace stratalux::fit {
namespace {

constexpr double kLeastFacing = 0.05;  // cosine between normal and view

// What two known quads in a row say of the one after them.
struct Continuation {
  Eigen::Vector2d ray;           // x / z, y / z
  Eigen::Vector3d plane;         // normal / distance: inverse depth along a ray (x, y, 1) is plane . ray
  Eigen::Vector3d normal;        // turned on
  double neighbour_depth = 0.0;  // z
};

class Rim {
 public:
  Rim(const SurfaceMap& surface, double max_edge_mm) : surface_(surface), max_edge_mm_(max_edge_mm) {}

  void Extend(int i, int j, SurfaceMap& out) const {
    std::array<Continuation, 8> from;
    size_t count = 0;
    for (int y = -1; y <= 1; ++y)
      for (int x = -1; x <= 1; ++x)
        if (x != 0 || y != 0)
          if (const auto one = Continue(i, j, x, y)) from[count++] = *one;
    if (count == 0) return;
    double nearest = std::numeric_limits<double>::infinity(), furthest = 0.0, inverse_depth = 0.0;
    Eigen::Vector2d ray = Eigen::Vector2d::Zero();
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    for (size_t k = 0; k < count; ++k) {
      nearest = std::min(nearest, from[k].neighbour_depth);
      furthest = std::max(furthest, from[k].neighbour_depth);
      ray += from[k].ray / static_cast<double>(count);
      normal += from[k].normal;
    }
    if (furthest - nearest > max_edge_mm_) return;
    for (size_t k = 0; k < count; ++k)
      inverse_depth += from[k].plane.dot(ray.homogeneous()) / static_cast<double>(count);
    normal.normalize();
    const Eigen::Vector3d view = ray.homogeneous().normalized();
    if (!(inverse_depth > 0.0) || -normal.dot(view) < kLeastFacing) return;
    const Eigen::Vector3d point = ray.homogeneous() / inverse_depth;
    if (std::abs(point.z() - 0.5 * (nearest + furthest)) > max_edge_mm_) return;
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
    const double distance = normal.dot(beside);  // of the tangent plane from the camera, negative
    if (!(distance < 0.0) || std::abs(beside.z() - behind.z()) > max_edge_mm_) return std::nullopt;
    return Continuation{2.0 * beside.hnormalized() - behind.hnormalized(), normal / distance,
                        2.0 * normal - surface_.Normal(i + 2 * dx, j + 2 * dy), beside.z()};
  }

  const SurfaceMap& surface_;
  double max_edge_mm_;
};

}  // namespace

SurfaceMap WithRim(const SurfaceMap& surface, double max_edge_mm) {
  SurfaceMap out = surface;
  const Rim rim(surface, max_edge_mm);
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      if (surface.mask(i, j) == 0) rim.Extend(i, j, out);
  return out;
}

}  // namespace stratalux::fit
