// SPDX-License-Identifier: Apache-2.0
// A projector module that holds all its patterns and steps at TRIGGER pulses.
//
// The memory is filled beforehand (`stratalux-rig plan render`) as its layout says (memory_layout.h); after the last
// pattern it begins anew. Load does not send patterns: it finds where in the memory they stand and steps there the
// shorter way (memory_way.h), pulse by pulse, each confirmed by SYNC. Where the memory stands is the number of its SYNC
// edges, since each edge is a pattern that went on, whatever became of the pulses.
#pragma once

#include <chrono>
#include <memory>
#include <vector>

#include "firmware-host/gpio/line_bank.h"
#include "firmware-host/gpio/pattern_memory_lines.h"
#include "firmware-host/projector/memory_way.h"
#include "firmware-host/projector/projector.h"
#include "firmware-host/safety/stop_token.h"

namespace stratalux::rig {

struct PatternMemoryOptions {
  int projector = 0;
  int width = 0;  // px
  int height = 0;
  std::vector<Pattern> memory;  // ProjectorMemory::patterns
  // With RESET that makes the first pattern the next one. Without, the memory must stand at its first pattern at the
  // start, as after power-up.
  MemoryTiming timing;
  std::chrono::nanoseconds sync_deadline = std::chrono::seconds(2);  // of one step
};

// Load fails with kUsage where the memory does not hold the sequence in that order; Load and Rest with kFailed where
// steps stay unconfirmed, and within 20 ms once stopped. Lines and token must outlive the projector.
[[nodiscard]] std::unique_ptr<Projector> MakePatternMemoryProjector(LineBank& lines, PatternMemoryLines& memory_lines,
                                                                    PatternMemoryOptions options,
                                                                    const StopToken& stop);

}  // namespace stratalux::rig
