// SPDX-License-Identifier: Apache-2.0
// STORE/write.lock: one writer of sessions at a time.
#pragma once

#include <filesystem>
#include <utility>

#include "shared/base/result.h"

namespace stratalux::db {

// Held while a session is written or forgotten; the kernel drops it with the process.
class WriteLock {
 public:
  // kBusy while another program (or another writer of this one) holds it.
  static Result<WriteLock> Take(const std::filesystem::path& store);
  WriteLock() = default;
  ~WriteLock();
  WriteLock(WriteLock&& o) noexcept : fd_(std::exchange(o.fd_, -1)) {}
  WriteLock& operator=(WriteLock&& o) noexcept {
    std::swap(fd_, o.fd_);
    return *this;
  }

 private:
  int fd_ = -1;
};

}  // namespace stratalux::db
