// SPDX-License-Identifier: Apache-2.0
// The two patterns that are alike everywhere.
#pragma once

#include "shared/pattern/pattern.h"

namespace stratalux::rig {

inline constexpr Pattern kWhitePattern = {.kind = PatternKind::kWhite};
inline constexpr Pattern kBlackPattern = {.kind = PatternKind::kBlack};

}  // namespace stratalux::rig
