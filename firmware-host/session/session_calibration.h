// SPDX-License-Identifier: Apache-2.0
// Which calibration a session names.
#pragma once

#include <string>

#include "firmware-host/config/rig_config.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::rig {

// What `capture --calibration` may say:
//   latest   the newest accepted calibration of this rig in the store; kNotFound where there is none
//   ID       an accepted one of this rig, by its id or a unique prefix
//   FILE     a record on the disk: a path with a / or ending in .json
//   none     no calibration
//   exact    simulation only: what the simulation knows of itself
//   ""       simulation: exact. A rig: latest, or none with a warning where there is none or it does not fit.
// Result: RigCalibration::ToJson, empty for none. A record that has outlived its validity is used with a warning.
// kUsage where a record that was asked for is of another camera or other projectors. `simulation`: its exact record;
// null on a rig. A store that does not exist yet holds no calibration.
[[nodiscard]] Result<std::string> ChooseCalibration(const std::string& asked, const RigConfig& config,
                                                    const RigCalibration* simulation, Logger& logger);

}  // namespace stratalux::rig
