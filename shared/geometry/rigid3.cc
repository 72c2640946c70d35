// SPDX-License-Identifier: Apache-2.0
#include "shared/geometry/rigid3.h"

#include <cmath>

namespace stratalux {
namespace {

constexpr double kParallel = 1e-9;  // sine of an angle

}  // namespace

Rigid3 LookAt(const Eigen::Vector3d& centre_mm, const Eigen::Vector3d& target_mm, const Eigen::Vector3d& down) {
  Eigen::Matrix3d world_from_device;
  const Eigen::Vector3d axis = (target_mm - centre_mm).normalized();
  Eigen::Vector3d right = down.normalized().cross(axis);
  if (right.norm() < kParallel)  // no turn about the axis is closer to `down` than another
    right = (std::abs(axis.x()) < 0.9 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitZ()).cross(axis);
  world_from_device.col(2) = axis;
  world_from_device.col(0) = right.normalized();
  world_from_device.col(1) = world_from_device.col(2).cross(world_from_device.col(0));
  return {Eigen::Quaterniond(world_from_device), centre_mm};
}

}  // namespace stratalux
