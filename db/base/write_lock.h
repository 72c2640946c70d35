// SPDX-License-Identifier: Apache-2.0
// STORE/write.lock: one session is written at a time. The kernel drops the lock with its process.
#pragma once

#include <filesystem>

#include "shared/base/result.h"

namespace stratalux::db {

class WriteLock {
 public:
  // kBusy while another program writes a session; asks again for half a second first, as openings hold it for a moment.
  static Result<WriteLock> Take(const std::filesystem::path& store);
  // kBusy at once.
  static Result<WriteLock> TryTake(const std::filesystem::path& store);
  // Asks without writing anything, also on a read-only disk.
  [[nodiscard]] static bool IsHeld(const std::filesystem::path& store);

  WriteLock() = default;
  ~WriteLock();
  WriteLock(WriteLock&& other) noexcept;
  WriteLock& operator=(WriteLock&& other) noexcept;

 private:
  int fd_ = -1;
};

}  // namespace stratalux::db
