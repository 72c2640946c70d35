// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/safety/guarded_gpio.h"

#include <new>
#include <string>
#include <thread>

namespace stratalux::rig {
namespace {

LineAddress At(ScriptedLine line) { return {"LINE" + std::to_string(line), "scripted", -1}; }

}  // namespace

GpioWiring GuardedGpio::Wiring() {
  GpioWiring wiring;
  const ScriptedLine enable[] = {kEnable0, kEnable1}, trigger[] = {kTrigger0, kTrigger1}, sync[] = {kSync0, kSync1};
  for (int p = 0; p < 2; ++p) {
    ProjectorLines& lines = wiring.projectors.emplace_back();
    lines.enable = OutputWiring{At(enable[p])};
    lines.trigger = OutputWiring{At(trigger[p])};
    lines.sync = InputWiring{At(sync[p])};
  }
  wiring.projectors[1].enable->active = ActiveLevel::kLow;
  wiring.camera_trigger = OutputWiring{At(kCamera)};
  wiring.emergency_stop = InputWiring{At(kEmergencyStop)};
  wiring.door = InputWiring{At(kDoor)};
  wiring.projector_pulse = wiring.camera_pulse = std::chrono::microseconds(10);
  return wiring;
}

GuardedGpio::GuardedGpio(StopToken& stop, LightGuardOptions options) {
  new (&TheGpio()) ScriptedGpio;
  lights = GpioLights::Open(Wiring()).value();
  bank = GpiodLineBank::Open(Wiring(), logger).value();
  guard = LightGuard::Start({{lights->enable(0)}, {lights->enable(1)}}, lights->interlock(), stop, options).value();
}

bool GuardedGpio::Lit(int projector) {
  const int level = TheGpio().lines[projector == 0 ? kEnable0 : kEnable1].level.load();
  return projector == 0 ? level != 0 : level == 0;
}

bool GuardedGpio::ReadBackDark() {
  return !Lit(0) && !Lit(1) && TheGpio().lines[kEnable0].last_read.load() == 0 &&
         TheGpio().lines[kEnable1].last_read.load() == 1;
}

bool GuardedGpio::DarkWithin(std::chrono::nanoseconds time) {
  const auto end = std::chrono::steady_clock::now() + time;
  while (Lit(0) || Lit(1)) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::microseconds(100));
  }
  return true;
}

}  // namespace stratalux::rig
