// SPDX-License-Identifier: Apache-2.0
// Time and memory of a piece of work.
#pragma once

#include <chrono>
#include <cstdint>

namespace stratalux::fit {

class Stopwatch {
 public:
  Stopwatch();
  [[nodiscard]] double Seconds() const;
  [[nodiscard]] double CpuSeconds() const;  // of all threads

 private:
  std::chrono::steady_clock::time_point start_;
  double cpu_start_;
};

// Of the whole process, up to now.
[[nodiscard]] int64_t PeakRssBytes();

}  // namespace stratalux::fit
