// SPDX-License-Identifier: Apache-2.0
#include "shared/units/time.h"

#include <ctime>

namespace stratalux {
namespace {
int64_t Read(clockid_t clock) {
  timespec t{};
  clock_gettime(clock, &t);
  return static_cast<int64_t>(t.tv_sec) * 1'000'000'000 + t.tv_nsec;
}
}  // namespace

MonotonicNs MonotonicNow() { return {Read(CLOCK_MONOTONIC)}; }
WallNs WallNow() { return {Read(CLOCK_REALTIME)}; }

std::string ToIso8601(WallNs time) {
  const std::time_t seconds = time.ns / 1'000'000'000;
  std::tm utc{};
  gmtime_r(&seconds, &utc);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &utc);
  return text;
}

}  // namespace stratalux
