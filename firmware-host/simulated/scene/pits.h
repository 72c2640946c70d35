// SPDX-License-Identifier: Apache-2.0
// Pores of a surface of any form: pits where it cuts small balls that are strewn through space (Worley, "A cellular
// texture basis function", 1996), so that no map of the surface is needed and none stretches them. As deep, as wide and
// as many an area as those of the procedural head.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace stratalux::rig {

class Pits {
 public:
  // Of the deepest, at its middle, in units of depth; where balls overlap it adds up.
  struct Depth {
    double depth = 0.0;
    Eigen::Vector3d slope = Eigen::Vector3d::Zero();  // its gradient, 1 / mm
  };
  // The balls within kReachMm of `centre`.
  static constexpr double kReachMm = 0.3;
  Pits(const Eigen::Vector3d& centre, uint64_t seed);
  // At a point no further than that from the centre.
  [[nodiscard]] Depth At(const Eigen::Vector3d& point) const;

 private:
  struct Ball {
    Eigen::Vector3d centre;
    double depth;
  };
  std::vector<Ball> balls_;
};

}  // namespace stratalux::rig
