// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig preview`: the live picture in a browser, for focusing and aiming.
#pragma once

#include <optional>

#include "firmware-host/config/rig_config.h"
#include "firmware-host/safety/stop_token.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// Until `stop`; says where the page is as a line of JSON on stdout. `port` of 127.0.0.1; 0: any free one. Fails as
// CaptureStation::Open, PreviewPage::Start and RunPreview.
[[nodiscard]] Status PreviewUntilStopped(const RigConfig& config, const std::optional<SimulatedRigOptions>& simulated,
                                         int port, StopToken& stop, Logger& logger);

}  // namespace stratalux::rig
