// SPDX-License-Identifier: Apache-2.0
// Display: a projector that is a screen of this computer. It steps at its own vertical blanks, not at TRIGGER pulses.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include "firmware-host/projector/projector.h"
#include "firmware-host/safety/light_switch.h"
#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::rig {

class Display : public Projector {
 public:
  // Asks for the next pattern of the sequence at the next vertical blank; after the last one the sequence begins anew.
  // kFailed while the flip before it is still awaited, before any Load, and where the screen was taken away.
  virtual Status Flip() = 0;
  // The vertical blank at which the pattern asked for began to be sent to the screen; nullopt at the deadline.
  virtual Result<std::optional<MonotonicNs>> WaitFlip(std::chrono::nanoseconds timeout) = 0;
  // Off: black at once, and every Flip shows black until it is on again; the place in the sequence goes on. On: the
  // next Flip shows its pattern. A new display is off.
  [[nodiscard]] virtual LightSwitch& light() = 0;
  // Vertical blanks that went by between asking and flipping, beyond the one a flip needs.
  [[nodiscard]] virtual int64_t skipped_vblanks() const = 0;
};

}  // namespace stratalux::rig
