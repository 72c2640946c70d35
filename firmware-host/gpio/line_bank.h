// SPDX-License-Identifier: Apache-2.0
// LineBank: the rig's digital lines behind one interface (libgpiod and simulated back-ends).
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::rig {

// Edge on a projector's SYNC input, with the kernel's time stamp and a running number that shows a lost edge.
struct SyncEdge {
  int projector = 0;
  int64_t sequence = 0;
  MonotonicNs time;
};

struct TriggerReceipt {
  int64_t number = 0;  // counts the pulses of this bank, from 0
  MonotonicNs time;
};

// SYNC, TRIGGER and STROBE. What makes light is the LightGuard's alone; START is an event (events/rig_events.h).
class LineBank {
 public:
  virtual ~LineBank() = default;
  // Pulses projector TRIGGER: the next pattern of its memory goes on. `projector` -1: all projectors at once.
  virtual Result<TriggerReceipt> TriggerProjector(int projector) = 0;
  // Pulses camera TRIGGER: one exposure starts.
  virtual Result<TriggerReceipt> TriggerCamera() = 0;
  // Next SYNC edge; nullopt at the deadline.
  virtual Result<std::optional<SyncEdge>> WaitSync(std::chrono::nanoseconds timeout) = 0;
  // Exposure as the camera's STROBE output shows it: start of the last one; nullopt where it is not wired.
  [[nodiscard]] virtual std::optional<MonotonicNs> LastStrobe() = 0;
};

}  // namespace stratalux::rig
