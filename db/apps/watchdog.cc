// SPDX-License-Identifier: Apache-2.0
#include "db/apps/watchdog.h"

#include <cstdlib>

#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::db {

Watchdog::Watchdog(std::chrono::milliseconds time, std::string message)
    : thread_([this, time, message = std::move(message)] {
        std::unique_lock lock(mutex_);
        if (changed_.wait_for(lock, time, [this] { return done_; })) return;
        Say(LogLevel::kError, message + "\n");
        std::_Exit(static_cast<int>(StatusCode::kFailed));
      }) {}

Watchdog::~Watchdog() {
  {
    const std::lock_guard lock(mutex_);
    done_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

}  // namespace stratalux::db
