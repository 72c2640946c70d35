// SPDX-License-Identifier: Apache-2.0
// What the LightGuard holds in hand: switches of light, and the inputs that take it away.
#pragma once

#include "firmware-host/safety/stop_token.h"

namespace stratalux::rig {

// One thing that makes a projector dark: its ENABLE line, or a display's black picture.
//
// Set and Read take no lock that another thread may hold for long, allocate nothing, log nothing: they are called by
// the guard's thread, by others at the same time, and in signal handlers.
class LightSwitch {
 public:
  virtual ~LightSwitch() = default;
  // 0 or errno. `false` once refused may be tried again.
  virtual int Set(bool on) noexcept = 0;
  // 0 or errno; what the hardware says, not what was last written.
  virtual int Read(bool& on) noexcept = 0;
  // A call may wait in the kernel, as for a display's refresh: all others are served first.
  [[nodiscard]] virtual bool may_wait() const noexcept { return false; }
  // For messages: "ENABLE0 (/dev/gpiochip0:4)".
  [[nodiscard]] virtual const char* name() const noexcept = 0;
};

// E-STOP and door.
class InterlockInput {
 public:
  virtual ~InterlockInput() = default;
  // Readable when something may have changed; -1: only asked at times.
  [[nodiscard]] virtual int fd() const noexcept = 0;
  // What is active, or was for a moment since the last call: kNone, kEmergencyStop, kDoorOpen; kLinesGone once it
  // cannot be told any more. Thread-safe, without allocation.
  virtual StopReason Take() noexcept = 0;
};

}  // namespace stratalux::rig
