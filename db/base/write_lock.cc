// SPDX-License-Identifier: Apache-2.0
#include "db/base/write_lock.h"

#include <chrono>
#include <thread>
#include <utility>

namespace stratalux::db {

Result<WriteLock> WriteLock::TryTake(const std::filesystem::path& store) {
  WriteLock lock;
  SLX_ASSIGN_OR_RETURN(lock.lock_, FileLock::TryTake(store / "write.lock",
                                                     "store " + store.string() +
                                                         " is being written by another program; try again when it has"
                                                         " finished"));
  return lock;
}

Result<WriteLock> WriteLock::Take(const std::filesystem::path& store) {
  using namespace std::chrono_literals;
  const auto deadline = std::chrono::steady_clock::now() + 500ms;
  while (true) {
    auto lock = TryTake(store);
    if (lock.status().code() != StatusCode::kBusy || std::chrono::steady_clock::now() > deadline) return lock;
    std::this_thread::sleep_for(10ms);
  }
}

bool WriteLock::IsHeld(const std::filesystem::path& store) { return FileLock::IsHeld(store / "write.lock"); }

}  // namespace stratalux::db
