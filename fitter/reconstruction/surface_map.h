// SPDX-License-Identifier: Apache-2.0
// The reconstructed surface, one sample a quad (model section 1), in the camera frame.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>

#include "shared/image/image.h"

namespace stratalux::fit {

struct SurfaceMap {
  Image<float> point_mm;        // W x H x 3, camera frame; NaN outside the mask
  Image<float> normal;          // W x H x 3, unit, out of the skin (towards the camera); NaN outside the mask
  Image<float> depth_sigma_mm;  // W x H, standard deviation along the camera ray
  Image<uint8_t> mask;          // W x H, 1 = surface known
  // W x H, quads: its normals are those of the skin blurred by a Gaussian of this standard deviation (SmoothSurface);
  // empty: by none that is known.
  Image<float> smoothing_quads = {};

  [[nodiscard]] int width() const { return mask.width(); }
  [[nodiscard]] int height() const { return mask.height(); }
  [[nodiscard]] Eigen::Vector3d Point(int i, int j) const {
    return {point_mm(i, j, 0), point_mm(i, j, 1), point_mm(i, j, 2)};
  }
  [[nodiscard]] Eigen::Vector3d Normal(int i, int j) const {
    return {normal(i, j, 0), normal(i, j, 1), normal(i, j, 2)};
  }
};

// Median distance of neighbouring points along rows, mm; 0 where there are none.
[[nodiscard]] double QuadSpacingMm(const SurfaceMap& surface);

}  // namespace stratalux::fit
