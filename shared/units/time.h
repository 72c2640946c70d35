// SPDX-License-Identifier: Apache-2.0
// Times with their clock in the type: edges, frames and steps are CLOCK_MONOTONIC nanoseconds; wall time is for people.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

namespace stratalux {

// CLOCK_MONOTONIC, ns.
struct MonotonicNs {
  int64_t ns = 0;
  friend auto operator<=>(const MonotonicNs&, const MonotonicNs&) = default;
  friend MonotonicNs operator+(MonotonicNs t, std::chrono::nanoseconds d) { return {t.ns + d.count()}; }
  friend std::chrono::nanoseconds operator-(MonotonicNs a, MonotonicNs b) {
    return std::chrono::nanoseconds(a.ns - b.ns);
  }
};

[[nodiscard]] constexpr std::chrono::nanoseconds FromMilliseconds(double ms) {
  return std::chrono::nanoseconds(static_cast<int64_t>(ms * 1e6));
}
[[nodiscard]] constexpr double ToMilliseconds(std::chrono::nanoseconds time) {
  return 1e-6 * static_cast<double>(time.count());
}

inline constexpr int64_t kSecondNs = 1'000'000'000;

// CLOCK_REALTIME, ns since 1970 UTC. Only shown to people; no order and no identity depends on it.
struct WallNs {
  int64_t ns = 0;
  friend auto operator<=>(const WallNs&, const WallNs&) = default;
};

enum class ClockSource : uint16_t { kUnknown = 0, kMonotonic = 1, kSimulated = 2 };

[[nodiscard]] MonotonicNs MonotonicNow();
[[nodiscard]] WallNs WallNow();
[[nodiscard]] std::string ToIso8601(WallNs time);  // "2026-11-21T04:06:11Z"

}  // namespace stratalux
