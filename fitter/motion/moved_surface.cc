// SPDX-License-Identifier: Apache-2.0
#include "fitter/motion/moved_surface.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "fitter/image/gaussian_blur.h"
#include "fitter/reconstruction/one_surface.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

Eigen::Vector2d OnQuads(const CameraCalibration& camera, const Eigen::Vector2d& pixel) {
  return (pixel - QuadCentre(camera.cfa, 0, 0)) / QuadStep(camera.cfa);
}

// Point and normal of the reference between its quads: bilinear on one surface, the nearest quad's beside an edge.
struct At {
  Eigen::Vector3d point, normal;
  float sigma = 0.0F;
};

std::optional<At> Between(const SurfaceMap& surface, const Eigen::Vector2d& at) {
  const int nearest_x = static_cast<int>(std::lround(at.x())), nearest_y = static_cast<int>(std::lround(at.y()));
  if (!surface.mask.contains(nearest_x, nearest_y) || surface.mask(nearest_x, nearest_y) == 0) return std::nullopt;
  At found{surface.Point(nearest_x, nearest_y), surface.Normal(nearest_x, nearest_y),
           surface.depth_sigma_mm(nearest_x, nearest_y)};
  const int x = static_cast<int>(std::floor(at.x())), y = static_cast<int>(std::floor(at.y()));
  if (!surface.mask.contains(x, y) || !surface.mask.contains(x + 1, y + 1)) return found;
  const double a = at.x() - x, b = at.y() - y;
  Eigen::Vector3d point = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::Zero();
  for (int dy = 0; dy < 2; ++dy)
    for (int dx = 0; dx < 2; ++dx) {
      if (surface.mask(x + dx, y + dy) == 0) return found;
      if (!OnOneSurface(surface, nearest_x, nearest_y, x + dx, y + dy)) return found;
      const double weight = (dx == 0 ? 1.0 - a : a) * (dy == 0 ? 1.0 - b : b);
      point += weight * surface.Point(x + dx, y + dy);
      normal += weight * surface.Normal(x + dx, y + dy);
    }
  found.point = point;
  found.normal = normal.normalized();
  return found;
}

}  // namespace

MovedSurface MoveSurface(const SurfaceMap& reference, const CameraCalibration& camera, const PoseOf& pose) {
  const int width = reference.width(), height = reference.height();
  const float nan = std::nanf("");
  MovedSurface moved{{Image<float>(width, height, 3, nan), Image<float>(width, height, 3, nan),
                      Image<float>(width, height, 1, nan), Image<uint8_t>(width, height)},
                     Image<float>(width, height, 2, nan)};
  constexpr int kSteps =
      4;  // a displacement that differs by a hundredth from quad to quad: each divides the error by 100
  ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j)
      for (int i = 0; i < width; ++i) {
        Eigen::Vector2d home(i, j);
        std::optional<At> at;
        Eigen::Vector3d now = Eigen::Vector3d::Zero();
        Rigid3 moving;
        for (int step = 0; step < kSteps; ++step) {
          at = Between(reference, home);
          if (!at) break;
          moving = pose(at->point);
          now = moving * at->point;
          const auto pixel = camera.model.Project(now);
          if (!pixel) {
            at.reset();
            break;
          }
          home += Eigen::Vector2d(i, j) - OnQuads(camera, *pixel);
        }
        if (!at) continue;
        const Eigen::Vector3d ray = camera.model.Unproject(QuadCentre(camera.cfa, i, j));
        const Eigen::Vector3d point = ray * (now.z() / ray.z()), normal = moving.rotation * at->normal;
        for (int k = 0; k < 3; ++k) {
          moved.surface.point_mm(i, j, k) = static_cast<float>(point[k]);
          moved.surface.normal(i, j, k) = static_cast<float>(normal[k]);
        }
        moved.surface.depth_sigma_mm(i, j) = at->sigma;
        moved.surface.mask(i, j) = 1;
        for (int k = 0; k < 2; ++k) moved.home(i, j, k) = static_cast<float>(home[k]);
      }
  });
  return moved;
}

Image<float> PlacesNow(const SurfaceMap& reference, const CameraCalibration& camera, const PoseOf& pose) {
  constexpr double kReachQuads = 3.0;  // of what is off the surface; far from it nothing is read
  const int width = reference.width(), height = reference.height();
  Image<float> displaced(width, height, 3);  // by how many quads along x and y, and whether that is known
  ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j)
      for (int i = 0; i < width; ++i) {
        if (reference.mask(i, j) == 0) continue;
        const Eigen::Vector3d point = reference.Point(i, j);
        const auto pixel = camera.model.Project(pose(point) * point);
        if (!pixel) continue;
        const Eigen::Vector2d by = OnQuads(camera, *pixel) - Eigen::Vector2d(i, j);
        displaced(i, j, 0) = static_cast<float>(by.x());
        displaced(i, j, 1) = static_cast<float>(by.y());
        displaced(i, j, 2) = 1.0F;
      }
  });
  const Image<float> around = GaussianBlur(displaced, kReachQuads);
  Image<float> places(width, height, 2);
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) {
      const Image<float>& from = displaced(i, j, 2) != 0.0F ? displaced : around;
      const float share = std::max(1e-12F, from(i, j, 2));
      places(i, j, 0) = static_cast<float>(i) + from(i, j, 0) / share;
      places(i, j, 1) = static_cast<float>(j) + from(i, j, 1) / share;
    }
  return places;
}

}  // namespace stratalux::fit
