// SPDX-License-Identifier: Apache-2.0
// The devices of the simulated rig: where its camera and projectors stand and what they are like, as an exact
// calibration.
#pragma once

#include "firmware-host/simulated/simulated_rig.h"

namespace stratalux::rig {

[[nodiscard]] RigCalibration DescribeSimulatedRig(const SimulatedRigOptions& options);

}  // namespace stratalux::rig
