// SPDX-License-Identifier: Apache-2.0
// Two projectors on scripted GPIO lines under a LightGuard, opened as the rig opens them.
#pragma once

#include <chrono>
#include <memory>

#include "firmware-host/gpio/gpio_lights.h"
#include "firmware-host/gpio/gpiod_line_bank.h"
#include "firmware-host/safety/light_guard.h"
#include "tests/firmware-host/safety/scripted_gpio.h"

namespace stratalux::rig {

enum ScriptedLine { kEnable0, kEnable1, kTrigger0, kTrigger1, kSync0, kSync1, kCamera, kEmergencyStop, kDoor };

// Longer than any test holds a light.
inline constexpr LightLease kLongLease = {.length = std::chrono::hours(1), .longest = std::chrono::hours(2)};

struct GuardedGpio {
  // `stop` outlives it. The lines are as a new chip has them.
  explicit GuardedGpio(StopToken& stop, LightGuardOptions options = {});

  [[nodiscard]] static GpioWiring Wiring();
  // As the hardware has it: projector 1 is lit while its line is low.
  [[nodiscard]] static bool Lit(int projector);
  // Every light off, and the last that anybody read of each.
  [[nodiscard]] static bool ReadBackDark();
  // Every light off; waits for it.
  [[nodiscard]] static bool DarkWithin(std::chrono::nanoseconds time);

  Logger logger{LogLevel::kError};
  std::unique_ptr<GpioLights> lights;
  std::unique_ptr<GpiodLineBank> bank;
  std::unique_ptr<LightGuard> guard;
};

}  // namespace stratalux::rig
