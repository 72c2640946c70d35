// SPDX-License-Identifier: Apache-2.0
// The subject of the simulated rig: a surface z = h(x, y) in the rig frame (camera at the origin, +z forward) and the
// melanin and blood of its skin. Procedural; another seed gives another face and another skin.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/simulated/skin/skin_optics.h"
#include "shared/base/result.h"
#include "shared/geometry/rigid3.h"
#include "shared/image/image.h"

namespace stratalux::rig {

// exp(-((x - cx) / sx)^2 - ((y - cy) / sy)^2) * amplitude.
struct Bump {
  double cx = 0, cy = 0, sx = 1, sy = 1, amplitude = 0;
  [[nodiscard]] double At(double x, double y) const;
};

class Scene {
 public:
  // "head", "plane" (tilted by 10 degrees) or "sphere"; kUsage for other names.
  static Result<Scene> Create(const std::string& name, uint64_t seed);
  // The same skin everywhere, for subjects whose light can be computed by hand.
  void UseUniformSkin(const SkinParameters& skin);

  // Depth of the surface, mm; NaN where there is none.
  [[nodiscard]] double Height(double x, double y) const;
  // First point of the ray on the surface; nullopt when it misses.
  [[nodiscard]] std::optional<Eigen::Vector3d> Intersect(const Ray3& ray) const;
  // Unit normal at a surface point, towards the camera's side (-z).
  [[nodiscard]] Eigen::Vector3d Normal(const Eigen::Vector3d& point) const;
  [[nodiscard]] SkinParameters Skin(const Eigen::Vector3d& point) const;
  [[nodiscard]] const std::string& name() const { return name_; }

 private:
  void BuildHead(uint64_t seed);
  void BuildSkin(uint64_t seed);
  void Tabulate();
  [[nodiscard]] double Tabulated(double x, double y) const;

  std::string name_;
  double centre_z_ = 760, radius_x_ = 76, radius_y_ = 102, radius_z_ = 85;
  std::vector<Bump> bumps_;
  double melanin_ = 0.03, blood_ = 0.004;
  std::vector<Bump> melanin_bumps_, blood_bumps_;  // relative: value = base (1 + sum)
  std::vector<Eigen::Vector2d> vessel_;
  Image<float> table_;  // h on a regular grid, to find the ray's bracket quickly
};

}  // namespace stratalux::rig
