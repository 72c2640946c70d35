// SPDX-License-Identifier: Apache-2.0
// Where the bundle adjustment starts: each device calibrated on its own [Zhang 2000, through OpenCV], projectors placed
// by the boards that both devices see.
#pragma once

#include <optional>

#include "fitter/calibration/bundle_adjustment.h"

namespace stratalux::fit {

// `known_camera`: its intrinsics, where they are known. kFailed names the device and pose that stands in the way.
[[nodiscard]] Result<Bundle> StartBundle(const CalibrationObservations& observations,
                                         const std::optional<Pinhole>& known_camera);

// The board's pose from the camera's corners alone; nullopt with fewer than 4, or where none fits.
[[nodiscard]] std::optional<Rigid3> BoardPoseFromCamera(const Pinhole& camera, const BoardDescription& board,
                                                        const PoseObservation& pose);

}  // namespace stratalux::fit
