// SPDX-License-Identifier: Apache-2.0
// Corners of a board as a known rig would see them, with noise: of finding corners (camera and projectors alike) and of
// looking them up (projectors alone).
#pragma once

#include <vector>

#include "fitter/calibration/observations.h"
#include "fitter/calibration/rig_geometry.h"
#include "shared/base/random.h"

namespace stratalux::fit {

struct BoardNoise {
  double corner_px = 0.05;  // camera px
  double lookup_px = 0.02;  // projector px
};

// One camera, projectors to its left, right and above.
[[nodiscard]] RigGeometry ExampleRig(int projectors);
// Twelve poses, tilted in all directions.
[[nodiscard]] std::vector<Rigid3> ExamplePoses();
[[nodiscard]] CalibrationObservations Observe(const RigGeometry& rig, const std::vector<Rigid3>& camera_from_board,
                                              const BoardNoise& noise, uint64_t seed);

}  // namespace stratalux::fit
