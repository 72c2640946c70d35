// SPDX-License-Identifier: Apache-2.0
#include "shared/geometry/rigid3.h"

namespace stratalux {

Rigid3 LookAt(const Eigen::Vector3d& centre_mm, const Eigen::Vector3d& target_mm, const Eigen::Vector3d& down) {
  Eigen::Matrix3d world_from_device;
  world_from_device.col(2) = (target_mm - centre_mm).normalized();
  world_from_device.col(0) = down.cross(world_from_device.col(2)).normalized();
  world_from_device.col(1) = world_from_device.col(2).cross(world_from_device.col(0));
  return {Eigen::Quaterniond(world_from_device), centre_mm};
}

}  // namespace stratalux
