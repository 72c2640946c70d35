// SPDX-License-Identifier: Apache-2.0
#include "db/base/retry.h"

#include <algorithm>
#include <cstdint>
#include <random>
#include <thread>

namespace stratalux::db {

Status RetryWhileBusy(std::chrono::milliseconds patience, const std::function<Status()>& attempt) {
  using std::chrono::milliseconds;
  using std::chrono::steady_clock;
  const auto deadline = steady_clock::now() + patience;
  std::mt19937 random(std::random_device{}());
  for (int64_t longest_ms = 20;; longest_ms = std::min<int64_t>(2 * longest_ms, 1000)) {
    Status status = attempt();
    if (status.code() != StatusCode::kBusy) return status;
    const milliseconds pause(std::uniform_int_distribution<int64_t>(longest_ms / 2, longest_ms)(random));
    if (steady_clock::now() + pause > deadline) return status;
    std::this_thread::sleep_for(pause);
  }
}

}  // namespace stratalux::db
