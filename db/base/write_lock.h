// SPDX-License-Identifier: Apache-2.0
// STORE/write.lock: one session is written at a time.
#pragma once

#include <filesystem>

#include "db/base/file_lock.h"

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

 private:
  FileLock lock_;
};

}  // namespace stratalux::db
