// SPDX-License-Identifier: Apache-2.0
// The way of a pattern memory, in the dark, to where a sequence comes next.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <span>

#include "shared/pattern/pattern.h"

namespace stratalux::rig {

// What a memory's movements take.
struct MemoryTiming {
  std::chrono::nanoseconds step{0};               // a TRIGGER, until SYNC confirms it
  std::optional<std::chrono::nanoseconds> reset;  // nullopt: it cannot be rewound but over the end
};

enum class WayStart : uint8_t {
  kHere,
  kReset,  // RESET first: the pattern of index 0 comes next
};

struct MemoryWay {
  WayStart start = WayStart::kHere;
  int64_t steps = 0;   // TRIGGER pulses; behind the last pattern comes the first again
  int64_t target = 0;  // index of what the next pulse then shows

  friend bool operator==(const MemoryWay&, const MemoryWay&) = default;
};

// To the place of `sequence`, patterns in a row, that is reached soonest; of ways that take equally long the one of
// fewer pulses. `next`: index that the next pulse shows; nullopt: not known, so that the way begins with RESET. nullopt
// where the memory does not hold the sequence, or no way is known.
[[nodiscard]] std::optional<MemoryWay> FindWay(std::span<const Pattern> memory, std::span<const Pattern> sequence,
                                               std::optional<int64_t> next, const MemoryTiming& timing);

[[nodiscard]] std::chrono::nanoseconds TimeOf(const MemoryWay& way, const MemoryTiming& timing);

}  // namespace stratalux::rig
