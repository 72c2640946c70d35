// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/watchdog.h"

#include <utility>

namespace stratalux::rig {

Watchdog::Watchdog(std::chrono::nanoseconds patience, std::function<Status()> bark)
    : patience_(patience), bark_(std::move(bark)) {
  if (patience_.count() > 0) thread_ = std::thread([this] { Watch(); });
}

Watchdog::~Watchdog() {
  {
    const std::lock_guard lock(mutex_);
    ending_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void Watchdog::Feed() {
  const std::lock_guard lock(mutex_);
  fed_ = std::chrono::steady_clock::now();
}

void Watchdog::Watch() {
  std::unique_lock lock(mutex_);
  while (!ending_) {
    const auto hungry = fed_ + patience_;
    if (std::chrono::steady_clock::now() < hungry) {
      changed_.wait_until(lock, hungry);
      continue;
    }
    barked_.store(true);
    lock.unlock();
    // A line that cannot be switched off is reported by the sequencer's own AllOff.
    (void)bark_().ok();
    return;
  }
}

}  // namespace stratalux::rig
