// SPDX-License-Identifier: Apache-2.0
// Whether a session can be run through the stages that are asked for.
#pragma once

#include "fitter/pipeline/run_options.h"
#include "fitter/session/session_frames.h"

namespace stratalux::fit {

// kUsage: no visitor's capture, no calibration, fewer projectors than the stages need; kFailed: a capture that is not
// over or went wrong.
[[nodiscard]] Status RequireFittable(const SessionFrames& frames, const RunOptions& options);

}  // namespace stratalux::fit
