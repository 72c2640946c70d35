// SPDX-License-Identifier: Apache-2.0
// A procedural head: a superellipse with the features of an adult face, nose root at the origin. Another seed, another
// face.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "firmware-host/simulated/scene/bump.h"
#include "firmware-host/simulated/scene/description.h"
#include "firmware-host/simulated/scene/face_skin.h"
#include "firmware-host/simulated/scene/hairs.h"
#include "firmware-host/simulated/scene/shape.h"

namespace stratalux::rig {

class Head : public HeightField {
 public:
  Head(const HeadDescription& description, FaceSkin skin, uint64_t seed);

  [[nodiscard]] double Height(double x, double y) const override;
  [[nodiscard]] Material MaterialAt(const Eigen::Vector3d& point, EyeLids lids) const override;

 private:
  struct Wrinkle {
    Polyline line;
    double sigma_mm = 1.0, depth_mm = 0.0;
    Eigen::AlignedBox2d reach;  // outside, it is not there
  };
  void AddFeatures();
  void AddWrinkles();
  void AddPores();
  void GrowHair();
  [[nodiscard]] double Pores(double x, double y) const;
  // nullopt: skin there.
  [[nodiscard]] std::optional<Material> EyeAt(double x, double y) const;

  HeadDescription description_;
  FaceSkin skin_;
  uint64_t seed_;
  double centre_z_ = 760, radius_x_ = 76, radius_y_ = 102, radius_z_ = 85;
  std::vector<Bump> bumps_;
  std::vector<Wrinkle> wrinkles_;
  Image<float> pores_;  // one a lattice cell: x, y, depth relative to pores_mm
  HairMap hairs_;
  double eye_y_ = -20.0;
};

}  // namespace stratalux::rig
