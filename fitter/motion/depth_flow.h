// SPDX-License-Identifier: Apache-2.0
// How a head moved between the codes of two projectors: each of them measures its depth alone, at its own moment
// (docs/math/motion.md, eq. 3).
#pragma once

#include "fitter/motion/rigid_flow.h"
#include "fitter/structured_light/decoded_map.h"

namespace stratalux::fit {

// On quads: length of the camera's ray to where one projector's codes see the surface (mm from the camera), and its
// standard deviation by their noise; NaN where they do not.
struct RangeMap {
  Image<float> range_mm, sigma_mm;
};

// Of a quad whose sites are all decoded. `projector`: of `rig`, whose camera is linear.
[[nodiscard]] RangeMap RangesOf(const DecodedMap& decoded, const RigCalibration& rig, size_t projector);

struct DepthFlowOptions {
  // What calibration and light that scattered leave between two projectors, beyond noise: of the shift along the view
  // and the turns that change depth.
  double model_sigma_mm = 0.05;
  double model_sigma_rad = 0.0005;
  // Across the view, and about it, a face slides along itself: that is left to the whites.
  double model_sigma_across_mm = 0.5;
  double model_sigma_roll_rad = 0.01;
  double robust_scale = 4.685;  // Tukey's
  int least_quads = 400;
};

// `a`, `b`: of the earlier and the later projector; `surface`: for normals. A shift along the surface does not change
// depths: of that the covariance says that nothing is known. nullopt where too few quads are common to both.
[[nodiscard]] std::optional<RigidFlow> FindDepthFlow(const RangeMap& a, const RangeMap& b, const SurfaceMap& surface,
                                                     const Eigen::Vector3d& pivot,
                                                     const DepthFlowOptions& options = {});

}  // namespace stratalux::fit
