// SPDX-License-Identifier: Apache-2.0
// The lines that the LightGuard holds: each projector's ENABLE, and E-STOP and DOOR.
//
// Each ENABLE line is a request of its own, so that no other line's trouble, not even another ENABLE's, keeps it from
// being written; E-STOP and DOOR are another one, which only the guard reads.
#pragma once

#include <memory>
#include <vector>

#include "firmware-host/events/rig_events.h"
#include "firmware-host/gpio/gpio_wiring.h"
#include "firmware-host/safety/light_switch.h"
#include "shared/base/result.h"

namespace stratalux::rig {

class GpioLights {
 public:
  virtual ~GpioLights() = default;
  // Takes the lines, ENABLE inactive. kNotFound: no such line or chip; kUsage: a line of that name on several chips;
  // kBusy: a line in use. `events` is told of E-STOP, door and lost lines as the guard sees them: what opens at once,
  // what closes within its rest_period. It outlives the lights, and may be null.
  static Result<std::unique_ptr<GpioLights>> Open(const GpioWiring& wiring, RigEvents* events = nullptr);

  // Null where the projector has no ENABLE line.
  [[nodiscard]] virtual LightSwitch* enable(int projector) const noexcept = 0;
  // Null where neither E-STOP nor DOOR is wired.
  [[nodiscard]] virtual InterlockInput* interlock() const noexcept = 0;
};

// `stratalux-rig safe`: each of these lines inactive, nothing else touched. kBusy where a running program holds one.
[[nodiscard]] Status DriveEnablesOff(const std::vector<OutputWiring>& enables);

}  // namespace stratalux::rig
