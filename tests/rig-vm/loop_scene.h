// SPDX-License-Identifier: Apache-2.0
// The scene of the virtual machine's loop: what its camera must see for a pattern. The responder paints it, the judge
// holds every stored frame against it.
#pragma once

#include <vector>

#include "shared/pattern/pattern.h"

namespace stratalux::rig {

inline constexpr int kLoopWidth = 320;  // of the camera's picture, px
inline constexpr int kLoopHeight = 240;
inline constexpr double kLoopBlack_dn = 64.0;
inline constexpr double kLoopNoise_dn = 4.0;  // standard deviation

// Light that the pattern adds, DN, row by row: a plane that is brighter in the middle. All projectors together stay
// below the 4095 of 12 bits.
[[nodiscard]] std::vector<float> LoopLight(const Pattern& pattern, int projector, int projector_width,
                                           int projector_height);

}  // namespace stratalux::rig
