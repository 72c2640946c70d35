// SPDX-License-Identifier: Apache-2.0
// The live picture for focusing and aiming: a frame every fifth of a second, of what the page's choice lights.
#pragma once

#include "firmware-host/preview/preview_page.h"
#include "firmware-host/session/capture_station.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// What the page may offer on this station: its projectors; exposures as a pre-scan may choose them, that of the
// configuration first, or the one that the camera has.
[[nodiscard]] PreviewPageOptions PreviewOptionsOf(const CaptureStation& station, const RigConfig& config);

// Until an operator's stop (StopToken); all lights are off then, whatever happened. Light is made under the guard's
// lease, of one projector at a time, for nine tenths of [capture] max_on_time_s, and lit again by who looks alone. What
// stops the light (E-STOP, door, camera, lease) is said, and is over when whoever looks presses Reset and the guard
// agrees. Nothing is stored. kFailed where a light cannot be switched off at the end.
[[nodiscard]] Status RunPreview(CaptureStation& station, const RigConfig& config, PreviewPage& page, StopToken& stop,
                                Logger& logger);

}  // namespace stratalux::rig
