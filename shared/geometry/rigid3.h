// SPDX-License-Identifier: Apache-2.0
// Rigid transforms, named target_from_source: x_in_target = target_from_source * x_in_source. Lengths in mm.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace stratalux {

struct Rigid3 {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation_mm = Eigen::Vector3d::Zero();

  Eigen::Vector3d operator*(const Eigen::Vector3d& x_in_source) const {
    return rotation * x_in_source + translation_mm;
  }
  // target_from_middle * middle_from_source.
  Rigid3 operator*(const Rigid3& middle_from_source) const {
    return {(rotation * middle_from_source.rotation).normalized(),
            rotation * middle_from_source.translation_mm + translation_mm};
  }
  [[nodiscard]] Rigid3 Inverse() const {
    const Eigen::Quaterniond inverse = rotation.conjugate();
    return {inverse, -(inverse * translation_mm)};
  }
};

struct Ray3 {
  Eigen::Vector3d origin_mm = Eigen::Vector3d::Zero();
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  // unit length
};

// Pose of a device at `centre_mm` whose +z axis looks at `target_mm` and whose +y axis is as close to `down` as it can
// be; where the axis is parallel to `down`, some turn about it.
[[nodiscard]] Rigid3 LookAt(const Eigen::Vector3d& centre_mm, const Eigen::Vector3d& target_mm,
                            const Eigen::Vector3d& down = Eigen::Vector3d::UnitY());

}  // namespace stratalux
