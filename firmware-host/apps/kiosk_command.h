// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig kiosk`: one visitor after another, with a page ([kiosk.page]) or lines on stdin and stdout.
#pragma once

#include <string>

#include "firmware-host/apps/capture_command.h"
#include "firmware-host/kiosk/kiosk.h"

namespace stratalux::rig {

// Until `stop` or the command stop. Frames are encrypted where the configuration does not say.
[[nodiscard]] Result<KioskReport> KioskUntilStopped(const CaptureJob& job, StopToken& stop, Logger& logger);

// One line of JSON, as the front's are.
[[nodiscard]] std::string KioskReportAsJson(const KioskReport& report);

}  // namespace stratalux::rig
