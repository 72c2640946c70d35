// SPDX-License-Identifier: Apache-2.0
// The surface at another moment than the reference's, on the camera's own quads, and which of its quads is which
// (docs/math/motion.md, "Carried").
#pragma once

#include <functional>

#include "fitter/reconstruction/surface_map.h"
#include "shared/capture/rig_calibration.h"
#include "shared/geometry/rigid3.h"

namespace stratalux::fit {

// Pose of a point of the surface (at the reference time): all of them the same, or of the moment at which a line passed
// over it.
using PoseOf = std::function<Rigid3(const Eigen::Vector3d& point)>;

struct MovedSurface {
  SurfaceMap surface;
  // W x H x 2: where on the surface of the reference time, in quads, that quad lies; NaN outside the mask.
  Image<float> home;
};

// Points on the rays through the quads' centres. Less than a millimetre comes into view at the edges: quads whose home
// lies off the reference's mask are not known.
[[nodiscard]] MovedSurface MoveSurface(const SurfaceMap& reference, const CameraCalibration& camera,
                                       const PoseOf& pose);

// Where the reference's quads are at that moment: W x H x 2, in quads; of quads off the surface as of their nearest
// neighbours on it, weighted by a Gaussian, so that a picture may be carried as a whole.
[[nodiscard]] Image<float> PlacesNow(const SurfaceMap& reference, const CameraCalibration& camera, const PoseOf& pose);

}  // namespace stratalux::fit
