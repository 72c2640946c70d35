// SPDX-License-Identifier: Apache-2.0
// A small rig before a plane: scene of the SRD tests.
#pragma once

#include "fitter/reconstruction/surface_map.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

inline constexpr int kWidth = 96, kHeight = 64;

RigCalibration SmallRig();

// A plane z = 700 + slope x, seen by every quad.
SurfaceMap Plane(const RigCalibration& rig, double slope);

}  // namespace stratalux::fit
