// SPDX-License-Identifier: Apache-2.0
// Pinhole model with Brown-Conrady distortion (OpenCV's order k1 k2 p1 p2 k3), for cameras and, as inverse cameras, for
// projectors. Device frame: +x right, +y down, +z forward; integer pixel coordinates are pixel centres.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "shared/base/result.h"
#include "shared/geometry/rigid3.h"

namespace stratalux {

struct Pinhole {
  int width = 0;
  int height = 0;
  double fx = 0.0, fy = 0.0, cx = 0.0, cy = 0.0;  // px
  std::array<double, 5> distortion{};             // k1 k2 p1 p2 k3

  // Pixel of a point in the device frame; nullopt for points at or behind the centre.
  [[nodiscard]] std::optional<Eigen::Vector2d> Project(const Eigen::Vector3d& x_in_device) const;
  // Unit direction, in the device frame, that the (sub-)pixel looks along. Inverts the distortion by Newton's method.
  [[nodiscard]] Eigen::Vector3d Unproject(const Eigen::Vector2d& pixel) const;
  [[nodiscard]] bool Contains(const Eigen::Vector2d& pixel) const {
    return pixel.x() > -0.5 && pixel.y() > -0.5 && pixel.x() < width - 0.5 && pixel.y() < height - 0.5;
  }
  [[nodiscard]] Status Validate() const;
};

}  // namespace stratalux
