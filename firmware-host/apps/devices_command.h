// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig devices`: the cameras, lines and displays of this machine.
#pragma once

#include <string>

#include "firmware-host/apps/device_list.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// kAsked: somebody named the file. kInstalled: it is that of the machine, and no reason to list nothing.
enum class ConfigurationFrom { kAsked, kInstalled };
// Of this machine; `config_file`: held against it, empty: none is. kUsage: a configuration that was asked for cannot be
// read; of the machine's own the list says why.
[[nodiscard]] Result<DeviceList> DevicesBeside(const std::string& config_file, ConfigurationFrom from);

// Tables of at most 100 columns, where no name is longer than that takes; one JSON object (docs/hardware.md).
[[nodiscard]] std::string DevicesAsText(const DeviceList& list);
[[nodiscard]] std::string DevicesAsJson(const DeviceList& list);

}  // namespace stratalux::rig
