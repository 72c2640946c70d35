// SPDX-License-Identifier: Apache-2.0
// Watchdog: switches the lights off when the thread that runs the capture makes no progress.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>

#include "shared/base/result.h"

namespace stratalux::rig {

class Watchdog {
 public:
  // Calls `bark` once, on a thread of its own, when Feed was not called for `patience` (0: never).
  Watchdog(std::chrono::nanoseconds patience, std::function<Status()> bark);
  ~Watchdog();
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;

  void Feed();
  [[nodiscard]] bool barked() const { return barked_.load(); }

 private:
  void Watch();

  const std::chrono::nanoseconds patience_;
  std::function<Status()> bark_;
  std::atomic<bool> barked_ = false;
  std::mutex mutex_;  // guards what follows
  std::condition_variable changed_;
  std::chrono::steady_clock::time_point fed_ = std::chrono::steady_clock::now();
  bool ending_ = false;
  std::thread thread_;
};

}  // namespace stratalux::rig
