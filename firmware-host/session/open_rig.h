// SPDX-License-Identifier: Apache-2.0
// The devices of one capture, opened: those that rig.toml wires, or the simulated rig in their place.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "firmware-host/config/rig_config.h"
#include "firmware-host/events/node_watch.h"
#include "firmware-host/events/rig_events.h"
#include "firmware-host/gpio/gpio_lights.h"
#include "firmware-host/safety/light_guard.h"
#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/simulated/control_pipe.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// Owns the devices. When it goes, all ENABLE lines are off and all displays black.
struct OpenedRig {
  std::unique_ptr<RigEvents> events;         // what happens to all of the next
  std::unique_ptr<SimulatedRig> simulation;  // null: real devices, which are the next but one
  std::unique_ptr<ControlPipe> control;      // of the simulation; null: nothing from outside
  std::unique_ptr<GpioLights> gpio_lights;   // null where the rig has no lines
  std::unique_ptr<LineBank> wired_lines;     // null where the rig has none: displays and a camera that runs free
  std::vector<std::unique_ptr<Projector>> projectors;  // they use `wired_lines`
  std::unique_ptr<LineBank> display_lines;             // over both; null on a rig without displays
  std::unique_ptr<FrameSource> camera;
  std::unique_ptr<NodeWatch> camera_watch;  // null: nobody sees it come and go
  std::unique_ptr<LightGuard> light;        // over all of them; goes first

  [[nodiscard]] RigDevices devices() const;
  // The camera once more, after it was unplugged. On failure the rig has none: each use says so until this goes well.
  [[nodiscard]] Status ReopenCamera(const CameraWiring& wiring, Logger& logger);
  // How settling passes on the simulated rig's own clock. Empty for real devices: real time, under the watchdog.
  [[nodiscard]] std::function<void(std::chrono::nanoseconds)> wait() const;
};

// kMayComeLater: without a camera the rig opens all the same, also where one is there that is not as the configuration
// has it; each use says why there is none, and RigSignal::kCamera says that it is away.
enum class CameraAtStart : uint8_t { kNeeded, kMayComeLater };

// The camera, as OpenRig opens it. kUsage: the configuration names none, or one of a back-end that this build lacks.
[[nodiscard]] Result<std::unique_ptr<FrameSource>> OpenCameraAtStart(const CameraWiring& wiring, CameraAtStart at_start,
                                                                     RigEvents& events, Logger& logger);

// `simulated` set: that rig. Else the configuration's devices. Their pattern memories hold what `config` lays out.
// kUsage where the configuration names no devices or this build lacks their back-end; kNotFound, kBusy and kFailed name
// the device.
[[nodiscard]] Result<OpenedRig> OpenRig(const RigConfig& config, const std::optional<SimulatedRigOptions>& simulated,
                                        StopToken& stop, Logger& logger,
                                        CameraAtStart at_start = CameraAtStart::kNeeded);

}  // namespace stratalux::rig
