// SPDX-License-Identifier: Apache-2.0
// Times of the stages and the process's peak memory, for metrics.json and the log.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "shared/base/log.h"

namespace stratalux::fit {

struct StageTime {
  std::string name;
  double seconds = 0.0;
  double cpu_seconds = 0.0;    // of all threads
  int64_t peak_rss_bytes = 0;  // of the whole process, up to the end of the stage
};

// Start() ends the stage before it. Equal names add up.
class StageClock {
 public:
  explicit StageClock(Logger& logger) : logger_(logger) {}
  void Start(const std::string& name);
  void Stop();
  [[nodiscard]] const std::vector<StageTime>& stages() const { return stages_; }

 private:
  Logger& logger_;
  std::string name_;
  std::chrono::steady_clock::time_point start_;
  double cpu_start_ = 0.0;
  std::vector<StageTime> stages_;
};

}  // namespace stratalux::fit
