// SPDX-License-Identifier: Apache-2.0
// Ends a program whose work cannot be interrupted.
#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

namespace stratalux::db {

// While it lives, the process has `time`: then `message` goes to stderr and it exits with code 1, at once, without
// destructors. For work that only reads.
class Watchdog {
 public:
  Watchdog(std::chrono::milliseconds time, std::string message);
  ~Watchdog();
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  bool done_ = false;
  std::thread thread_;
};

}  // namespace stratalux::db
