// SPDX-License-Identifier: Apache-2.0
// WorkWatch: one long computation of the simulated rig, which a stop ends early and a progress bar shows.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>

#include "firmware-host/safety/stop_token.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

class WorkWatch {
 public:
  // `stop` may be null: nothing ends the work. Both outlive the watch.
  WorkWatch(Logger& logger, std::string label, const StopToken* stop);

  // So many steps more are to be done.
  void Expect(int64_t steps) { expected_ += steps; }
  // Thread-safe. What is done within half a second is not worth a line.
  void Advance(int64_t steps);
  [[nodiscard]] bool stopped() const { return stop_ != nullptr && stop_->stopped(); }
  // kFailed with the stop's reason: the work is incomplete.
  [[nodiscard]] Status Check() const { return stop_ == nullptr ? Status::Ok() : stop_->Check(); }

 private:
  Logger& logger_;
  const std::string label_;
  const StopToken* stop_;
  const std::chrono::steady_clock::time_point start_;
  std::atomic<int64_t> expected_ = 0;
  std::mutex mutex_;
  std::unique_ptr<Progress> progress_;
  int64_t unshown_ = 0;
};

// ParallelFor that asks before each chunk; each item counts `steps`. `watch` may be null. False: stopped before the
// end.
bool WatchedParallelFor(WorkWatch* watch, int64_t count, int64_t grain, int64_t steps,
                        const std::function<void(int64_t begin, int64_t end)>& body);

}  // namespace stratalux::rig
