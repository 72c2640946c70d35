// SPDX-License-Identifier: Apache-2.0
// GPIO without a kernel: what gpio_adapter.h declares, over memory that outlives the process which drives the lines. A
// test program that links scripted_gpio.cc has this instead of the kernel's lines.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

namespace stratalux::rig {

// One chip "/dev/gpiochip9" (label "scripted") of 32 lines LINE0 .. LINE31. Lock-free, so that it may be shared between
// processes.
struct ScriptedGpio {
  static constexpr int kLines = 32;
  struct Line {
    std::atomic<int> level = 0;                            // as driven, or as the world outside puts it
    std::atomic<int> taken = 0;                            // by a request
    std::atomic<int> writes = 0;                           // that reached it
    std::atomic<int> last_read = -1;                       // the level, by whoever drives it; -1: never
    std::atomic<int64_t> changed_ns = 0;                   // CLOCK_MONOTONIC, when a write last changed the level
    std::atomic<int> refuse_writes = 0, refuse_reads = 0;  // so many to come fail with EIO; -1: all
    std::atomic<int> edges = 0;                            // rising ones that nobody has read
    std::atomic<int> event_fd = -1;                        // of the process that took it as an input
  };
  std::array<Line, kLines> lines;

  // The world outside puts an input high; pressed for a moment, or held.
  void Raise(int line, bool held);
};

// The chip of this process and of those that it forks off after the first call.
[[nodiscard]] ScriptedGpio& TheGpio();

}  // namespace stratalux::rig
