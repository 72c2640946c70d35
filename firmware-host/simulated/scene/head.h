// SPDX-License-Identifier: Apache-2.0
// A procedural head: a superellipse with the features of an adult face, nose root at the origin. Another seed, another
// face.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "firmware-host/simulated/scene/bump.h"
#include "firmware-host/simulated/scene/description.h"
#include "firmware-host/simulated/scene/face_features.h"
#include "firmware-host/simulated/scene/face_skin.h"
#include "firmware-host/simulated/scene/face_surface.h"
#include "firmware-host/simulated/scene/hairs.h"
#include "firmware-host/simulated/scene/shape.h"

namespace stratalux::rig {

class Head : public HeightField {
 public:
  Head(const HeadDescription& description, const FaceFeatures& features, FaceSkin skin, const FaceSurface& surface,
       uint64_t seed);

  [[nodiscard]] double Height(double x, double y) const override;
  [[nodiscard]] Material MaterialAt(const Eigen::Vector3d& point, EyeLids lids) const override;

 private:
  struct Wrinkle {
    Polyline line;
    double sigma_mm = 1.0, depth_mm = 0.0;
    Eigen::AlignedBox2d reach;  // outside, it is not there
  };
  void AddWrinkles();
  void AddPores();
  void GrowHair();
  [[nodiscard]] double Pores(double x, double y) const;
  // nullopt: skin there.
  [[nodiscard]] std::optional<Material> EyeAt(double x, double y) const;
  [[nodiscard]] bool InNostril(double x, double y) const;

  HeadDescription description_;
  FaceFeatures features_;
  FaceSkin skin_;
  FaceSurface surface_;
  uint64_t seed_;
  double centre_z_ = 760;
  std::vector<Bump> bumps_;
  std::vector<Wrinkle> wrinkles_;
  Image<float> pores_;  // one a lattice cell: x, y, depth relative to pores_mm
  HairMap hairs_;
  Bump nostril_;  // the pit, at +x; mirrored
  double eye_y_;
};

}  // namespace stratalux::rig
