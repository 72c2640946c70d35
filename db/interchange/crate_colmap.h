// SPDX-License-Identifier: Apache-2.0
// A rig's calibration in COLMAP's text format, for other programs of photogrammetry. Internal to db/interchange.
#pragma once

#include <string>

#include "shared/capture/rig_calibration.h"

namespace stratalux::db {

struct ColmapText {
  std::string cameras, images, points;  // cameras.txt, images.txt, points3D.txt (which holds no points)
};

// World: the camera's frame, mm. Camera and image 1 are the camera, k + 2 the projector k as an inverse camera; image 1
// is called `camera_image`, those of the projectors have names only. All are FULL_OPENCV, whose parameters are
//
//   fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6,    k4 = k5 = k6 = 0: Brown-Conrady as here (shared/geometry/pinhole.h).
//
// COLMAP's pixel (0, 0) reaches from 0 to 1 and has its centre at (0.5, 0.5), ours at (0, 0): cx and cy are those of
// the record + 0.5. Poses are world to camera: x_in_camera = R(qw qx qy qz) x_in_world + t.
[[nodiscard]] ColmapText ColmapTextOf(const RigCalibration& calibration, const std::string& camera_image);

}  // namespace stratalux::db
