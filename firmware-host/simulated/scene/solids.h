// SPDX-License-Identifier: Apache-2.0
// Subjects whose light can be computed by hand: a tilted plane and a sphere of skin, a matt bowl.
#pragma once

#include <utility>

#include "firmware-host/simulated/scene/face_skin.h"
#include "firmware-host/simulated/scene/face_surface.h"
#include "firmware-host/simulated/scene/shape.h"

namespace stratalux::rig {

// Turned by 10 degrees about y, 700 mm away on the axis, without an edge in sight.
class TiltedPlane : public HeightField {
 public:
  TiltedPlane(FaceSkin skin, const FaceSurface& surface) : skin_(std::move(skin)), surface_(surface) { Tabulate(); }
  [[nodiscard]] double Height(double x, double y) const override;
  [[nodiscard]] Material MaterialAt(const Eigen::Vector3d& point, EyeLids) const override {
    return Material::Skin(skin_.At(point.x(), point.y()), surface_.At(point.x(), point.y()));
  }

 private:
  FaceSkin skin_;
  FaceSurface surface_;
};

// Radius 80 mm, centre 760 mm away on the axis.
class Sphere : public HeightField {
 public:
  Sphere(FaceSkin skin, const FaceSurface& surface) : skin_(std::move(skin)), surface_(surface) { Tabulate(); }
  [[nodiscard]] double Height(double x, double y) const override;
  [[nodiscard]] Material MaterialAt(const Eigen::Vector3d& point, EyeLids) const override {
    return Material::Skin(skin_.At(point.x(), point.y()), surface_.At(point.x(), point.y()));
  }

 private:
  FaceSkin skin_;
  FaceSurface surface_;
};

// The far half of a sphere of radius 80 mm about the point 660 mm away on the axis, seen from inside, sunk into a flat
// board: each of its points lights all others alike, as in an integrating sphere.
class Bowl : public HeightField {
 public:
  static constexpr double kRadiusMm = 80.0;
  explicit Bowl(double albedo) : albedo_(static_cast<float>(albedo)) { Tabulate(); }
  [[nodiscard]] double Height(double x, double y) const override;
  [[nodiscard]] Material MaterialAt(const Eigen::Vector3d&, EyeLids) const override {
    return Material::Matt({albedo_, albedo_, albedo_});
  }

 private:
  float albedo_;
};

}  // namespace stratalux::rig
