// SPDX-License-Identifier: Apache-2.0
// PatternMemoryLines: what a pattern memory needs of the lines beyond the pulses of LineBank.
#pragma once

#include <cstdint>

#include "shared/base/result.h"

namespace stratalux::rig {

class PatternMemoryLines {
 public:
  virtual ~PatternMemoryLines() = default;
  // Pulses RESET: the next TRIGGER shows the first pattern. kUsage where that line is not wired.
  virtual Status ResetMemory(int projector) = 0;
  // SYNC edges of a projector so far, by the kernel's count: those dropped before anybody read them are in it.
  [[nodiscard]] virtual int64_t SyncCount(int projector) = 0;
};

}  // namespace stratalux::rig
