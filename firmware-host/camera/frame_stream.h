// SPDX-License-Identifier: Apache-2.0
// FrameStream: numbers and time stamps of a driver's frames as FrameSource promises them. Pure, for every back-end.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include "shared/units/time.h"

namespace stratalux::rig {

// CLOCK_BOOTTIME, which sensors' stamps are on, runs ahead of CLOCK_MONOTONIC by the time the machine was suspended.
[[nodiscard]] std::chrono::nanoseconds TimeSuspended();

class FrameStream {
 public:
  // Number of a frame from the driver's 32-bit one, carried over its wrap. A frame that comes out of order gets a
  // number of the past.
  [[nodiscard]] int64_t Number(uint32_t driver_number);
  // The driver will count anew. At least one frame is lost: the next number leaves a gap.
  void Reopened() { driver_number_.reset(); }

  // False for a stamp that lies before the frame's predecessor or far in the future: a wrapped or broken clock. `now`
  // is CLOCK_MONOTONIC when the frame was read.
  [[nodiscard]] bool StampFits(MonotonicNs stamp, MonotonicNs now);

 private:
  std::optional<uint32_t> driver_number_;
  std::optional<int64_t> number_;
  std::optional<MonotonicNs> stamp_;
};

}  // namespace stratalux::rig
