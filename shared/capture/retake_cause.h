// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace stratalux {

// FrameRecord::retake_cause of what a jump of the subject had shot again: the frame before it shows what was planned,
// and where the subject was (docs/capture-plan.md, "A subject who jumps").
inline constexpr const char* kRetakenForAJump = "subject moved";

}  // namespace stratalux
