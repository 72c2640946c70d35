// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig devices`: the cameras, lines and displays of this machine.
#pragma once

#include <string>

#include "firmware-host/apps/device_list.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// Of this machine; `config_file`: held against it, empty: none is. kUsage: the configuration cannot be read.
[[nodiscard]] Result<DeviceList> DevicesBeside(const std::string& config_file);

// Tables of at most 100 columns, where no name is longer than that takes; one JSON object (docs/hardware.md).
[[nodiscard]] std::string DevicesAsText(const DeviceList& list);
[[nodiscard]] std::string DevicesAsJson(const DeviceList& list);

}  // namespace stratalux::rig
