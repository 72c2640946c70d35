// SPDX-License-Identifier: Apache-2.0
// A projector module that holds its whole sequence and steps at TRIGGER pulses.
//
// The memory is filled beforehand (`stratalux-rig plan render`) with all the plan shows on this projector, in the
// plan's order; after the last pattern it begins anew. Load does not send patterns: it finds where in the memory they
// stand and steps there, pulse by pulse, each confirmed by SYNC. Where the memory stands is the number of its SYNC
// edges, since each edge is a pattern that went on, whatever became of the pulses.
#pragma once

#include <chrono>
#include <memory>
#include <vector>

#include "firmware-host/gpio/line_bank.h"
#include "firmware-host/gpio/pattern_memory_lines.h"
#include "firmware-host/projector/projector.h"
#include "firmware-host/safety/stop_token.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

// What the memory of a projector holds: the pre-roll markers, then its own steps.
[[nodiscard]] std::vector<Pattern> MemoryOf(const CapturePlan& plan, int projector);

enum class MemoryRewind : uint8_t {
  kResetLine,   // a RESET pulse makes the first pattern the next one
  kStepAround,  // over the end; at the start the memory must stand at its first pattern, as after power-up
};

struct PatternMemoryOptions {
  int projector = 0;
  int width = 0;  // px
  int height = 0;
  std::vector<Pattern> memory;
  MemoryRewind rewind = MemoryRewind::kStepAround;
  std::chrono::nanoseconds sync_deadline = std::chrono::seconds(2);  // of one step
};

// Load fails with kUsage where the memory does not hold the sequence in that order, with kFailed where steps stay
// unconfirmed, and within 20 ms once stopped. Lines and token must outlive the projector.
[[nodiscard]] std::unique_ptr<Projector> MakePatternMemoryProjector(LineBank& lines, PatternMemoryLines& memory_lines,
                                                                    PatternMemoryOptions options,
                                                                    const StopToken& stop);

}  // namespace stratalux::rig
