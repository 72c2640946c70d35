// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/memory_way.h"

#include <algorithm>
#include <tuple>

namespace stratalux::rig {

std::chrono::nanoseconds TimeOf(const MemoryWay& way, const MemoryTiming& timing) {
  const std::chrono::nanoseconds start =
      way.start == WayStart::kReset ? timing.reset.value_or(std::chrono::nanoseconds(0)) : std::chrono::nanoseconds(0);
  return start + way.steps * timing.step;
}

std::optional<MemoryWay> FindWay(std::span<const Pattern> memory, std::span<const Pattern> sequence,
                                 std::optional<int64_t> next, const MemoryTiming& timing) {
  std::optional<MemoryWay> best;
  const auto offer = [&](const MemoryWay& way) {
    const auto rank = [&](const MemoryWay& w) { return std::tuple(TimeOf(w, timing), w.steps, w.start, w.target); };
    if (!best || rank(way) < rank(*best)) best = way;
  };
  const auto size = static_cast<int64_t>(memory.size());
  for (auto at = memory.begin();; ++at) {
    at = std::search(at, memory.end(), sequence.begin(), sequence.end());
    if (at == memory.end()) return best;
    const int64_t target = at - memory.begin();
    if (next) offer({WayStart::kHere, (target - *next % size + size) % size, target});
    if (timing.reset) offer({WayStart::kReset, target, target});
  }
}

}  // namespace stratalux::rig
