// SPDX-License-Identifier: Apache-2.0
// What the operator is told before a calibration capture.
#pragma once

#include <string>

#include "shared/capture/plan.h"

namespace stratalux::rig {

inline constexpr int kAdvisedPoses = 12;

// How to hold the board for pose 0, 1, ...; after kAdvisedPoses the list begins again, elsewhere in the picture. The
// poses lean in all directions, reach the edges of the picture and both ends of the working depth
// (docs/calibration.md).
[[nodiscard]] std::string PoseInstruction(int pose);
// Of kinds dark, flat and response: what must be in front of the rig. Empty for the others. Flat captures 0, 1 and 2
// differ in depth and tilt, by which vignetting and fall-off are told apart.
[[nodiscard]] std::string LightInstruction(SessionKind kind, int pose = 0);

}  // namespace stratalux::rig
