// SPDX-License-Identifier: Apache-2.0
// A rig in the dark, until somebody presses START.
#pragma once

#include "firmware-host/session/capture_station.h"

namespace stratalux::rig {

// Ok: START was pressed while nothing spoke against it. While the door is open, E-STOP is pressed or the camera is away
// START is refused, and said to be; once that is over the station goes on (LightGuard::Reset, ReopenCamera) and waits
// on. START pressed before the call is nobody's. kFailed within 20 ms of an operator's stop (a camera that is being
// opened is waited for), and for whatever else stops the work. `stop` is the station's.
[[nodiscard]] Status AwaitStart(CaptureStation& station, StopToken& stop, Logger& logger);

}  // namespace stratalux::rig
