// SPDX-License-Identifier: Apache-2.0
// Costly cases of which one is drawn by day: each law has its sample with the other tests, and all of it at night.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <ctime>

namespace stratalux {

// STRATALUX_SEED, else the number of the day: the same for all programs of a run, but over midnight.
inline uint64_t SeedOfTheDay() {
  constexpr int64_t kDay_s = 24 * 60 * 60;
  const char* seed = std::getenv("STRATALUX_SEED");
  return seed != nullptr ? std::strtoull(seed, nullptr, 10) : static_cast<uint64_t>(std::time(nullptr) / kDay_s);
}

// Whether case `which` of 0 .. of - 1 is the drawn one.
inline bool IsDrawn(uint64_t which, uint64_t of) { return SeedOfTheDay() % of == which; }

}  // namespace stratalux
