// SPDX-License-Identifier: Apache-2.0
// A scene file: subject, devices and faults of one simulation (docs/simulated-rig.md, docs/examples/scenes/).
#pragma once

#include <string>

#include "firmware-host/simulated/device_options.h"
#include "firmware-host/simulated/fault_script.h"
#include "firmware-host/simulated/scene/description.h"

namespace stratalux::rig {

struct Simulation {
  SceneDescription scene;
  DeviceOptions devices;
  FaultOptions faults;
};

// `name_or_file`: a shape's name (SceneOfName), or a TOML file. kUsage (exit 2) with file:line for what a file may not
// say.
[[nodiscard]] Result<Simulation> LoadSimulation(const std::string& name_or_file);

}  // namespace stratalux::rig
