// SPDX-License-Identifier: Apache-2.0
// A file that one program holds at a time (flock). The kernel drops the lock with its process.
#pragma once

#include <filesystem>
#include <string>

#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {

class FileLock {
 public:
  // Makes the file where it is missing. kBusy at once, saying `busy`, while another holds it.
  static Result<FileLock> TryTake(const std::filesystem::path& file, const std::string& busy);
  // Asks without writing anything, also on a read-only disk.
  [[nodiscard]] static bool IsHeld(const std::filesystem::path& file);
  FileLock() = default;

 private:
  UniqueFd fd_;
};

}  // namespace stratalux::db
