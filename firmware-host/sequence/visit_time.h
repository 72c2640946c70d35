// SPDX-License-Identifier: Apache-2.0
// How long a capture takes, from the memories' rest to the last frame.
#pragma once

#include <chrono>
#include <optional>
#include <span>

#include "firmware-host/camera/camera_timing.h"
#include "firmware-host/projector/memory_layout.h"
#include "firmware-host/projector/memory_way.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

struct VisitTiming {
  std::chrono::nanoseconds settle = std::chrono::milliseconds(2);
  CameraTiming camera;
  // What the devices themselves take: from TRIGGER to SYNC, and from the end of an exposure until its frame is here.
  std::chrono::nanoseconds sync_delay = std::chrono::microseconds(500);
  std::chrono::nanoseconds transfer = std::chrono::milliseconds(15);
  std::chrono::nanoseconds frame_period =
      std::chrono::nanoseconds(0);  // of a free-running camera; 0: as fast as it can
  // The pattern memories' way, one after the other, from where they rest to the plan's section (LoadingTime).
  std::chrono::nanoseconds loading = std::chrono::nanoseconds(0);
};

// Nothing shot again, and what the computer does for a frame done while the next one is exposed. Step by step as the
// sequencer goes about it: markers one by one; a projector's steps while the last frame is read out, except where the
// exposure changes and before the sweep, whose judges, the codes, are settled first.
[[nodiscard]] std::chrono::nanoseconds VisitTime(const CapturePlan& plan, const VisitTiming& timing);

// What the memories of that layout take from where they rest (Projector::Rest) to where `plan` begins. 0 of a memory
// that does not hold it. `timing`: of each memory; nullopt: a projector without one.
[[nodiscard]] std::chrono::nanoseconds LoadingTime(const CapturePlan& plan, const MemoryLayout& layout,
                                                   std::span<const std::optional<MemoryTiming>> timing);

}  // namespace stratalux::rig
