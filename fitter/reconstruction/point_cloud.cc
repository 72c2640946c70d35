// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/point_cloud.h"

#include <cmath>

#include "shared/geometry/quad.h"

namespace stratalux::fit {

Eigen::Matrix3d PointCovariance(const Eigen::Vector3d& point_mm, double depth_sigma_mm,
                                const CameraCalibration& camera) {
  const Eigen::Vector3d ray = point_mm.normalized();
  const Eigen::Matrix3d along = ray * ray.transpose();
  const double side_mm = QuadStep(camera.cfa) * point_mm.z() / std::sqrt(camera.model.fx * camera.model.fy);
  return depth_sigma_mm * depth_sigma_mm * along + side_mm * side_mm / 12.0 * (Eigen::Matrix3d::Identity() - along);
}

PointCloud CloudFromSurface(const SurfaceMap& surface, const CameraCalibration& camera,
                            ImageView<const float> normal_sigma_rad) {
  PointCloud cloud;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      const Eigen::Vector3f point = surface.Point(i, j).cast<float>(), normal = surface.Normal(i, j).cast<float>();
      const Eigen::Matrix3f c =
          PointCovariance(surface.Point(i, j), surface.depth_sigma_mm(i, j), camera).cast<float>();
      cloud.positions_mm.push_back({point.x(), point.y(), point.z()});
      cloud.normals.push_back({normal.x(), normal.y(), normal.z()});
      cloud.normal_sigma_rad.push_back(normal_sigma_rad.empty() ? std::nanf("") : normal_sigma_rad(i, j));
      cloud.covariance_mm2.push_back({c(0, 0), c(0, 1), c(0, 2), c(1, 1), c(1, 2), c(2, 2)});
    }
  return cloud;
}

}  // namespace stratalux::fit
