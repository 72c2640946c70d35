// SPDX-License-Identifier: Apache-2.0
// The smallest plan that a fit accepts, as the [plan] of a rig.toml.
#pragma once

#include <string>

#include "tests/support/text_file.h"

namespace stratalux {

inline const std::string kSmallestPlan = ReadText(STRATALUX_SOURCE_DIR "/tests/support/smallest_plan.toml");

}  // namespace stratalux
