// SPDX-License-Identifier: Apache-2.0
// A subject's surface in a frame of its own: the rig frame (camera at the origin, +z forward) while the
// subject rests. Lengths in mm. Immutable, hence safe from any thread.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/simulated/scene/material.h"
#include "shared/geometry/rigid3.h"
#include "shared/image/image.h"

namespace stratalux::rig {

enum class EyeLids { kAsDescribed, kClosed };

class Shape {
 public:
  virtual ~Shape() = default;
  // Depth of the surface as seen along z; NaN where there is none.
  [[nodiscard]] virtual double Height(double x, double y) const = 0;
  // First point of the ray on the surface.
  [[nodiscard]] virtual std::optional<Eigen::Vector3d> Intersect(const Ray3& ray) const = 0;
  // Unit normal at a surface point, out of the body: towards -z where it is seen from the front.
  [[nodiscard]] virtual Eigen::Vector3d Normal(const Eigen::Vector3d& point) const = 0;
  // Whether the surface itself stands between two of its points.
  [[nodiscard]] virtual bool Hides(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const = 0;
  [[nodiscard]] virtual Material MaterialAt(const Eigen::Vector3d& point, EyeLids lids) const = 0;
  // What whoever described it should be told, a line each.
  [[nodiscard]] virtual std::vector<std::string> Remarks() const { return {}; }
};

// A curved surface, between 560 and 800 mm from the camera and within 170 mm of its axis: rays leap to where it can
// be, are marched through a table of h and end by regula falsi on h itself.
class HeightField : public Shape {
 public:
  [[nodiscard]] std::optional<Eigen::Vector3d> Intersect(const Ray3& ray) const override;
  [[nodiscard]] Eigen::Vector3d Normal(const Eigen::Vector3d& point) const override;
  [[nodiscard]] bool Hides(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const override;

 protected:
  // To be called once Height() is ready.
  void Tabulate();

 private:
  [[nodiscard]] double Tabulated(double x, double y) const;
  // How far a ray that passes `point` and goes away from the camera by `rise` mm a mm stays in front of all of the
  // table, `reach_mm` at most; 0 near it.
  [[nodiscard]] double FreeMm(const Eigen::Vector3d& point, double rise, double reach_mm) const;

  Image<float> table_;
  Image<float> nearest_;  // a square of the table each: the least depth in it and in the eight around it, or infinity
};

}  // namespace stratalux::rig
