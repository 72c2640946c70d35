// SPDX-License-Identifier: Apache-2.0
// The smallest plan that a fit accepts, as the [plan] of a rig.toml.
#pragma once

#include <string>

namespace stratalux {

inline const std::string kSmallestPlan = R"([plan]
projector_width = 128
projector_height = 96
preroll_markers = 4
separation_shifts = 3
comb_period = 32
comb_step = 2
spot_radius = 0
motion_whites = 0
guards = 1
)";

}  // namespace stratalux
