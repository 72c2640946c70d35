// SPDX-License-Identifier: Apache-2.0
// An advisory lock by name: artifacts/.lock-<name>, held by one process at a time. The kernel drops it with the
// process.
#pragma once

#include <filesystem>
#include <string>

#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::fit {

class KeyLock {
 public:
  // Not held() where another holds it.
  [[nodiscard]] static Result<KeyLock> Try(const std::filesystem::path& file);

  KeyLock() = default;
  KeyLock(KeyLock&& other) noexcept;
  KeyLock& operator=(KeyLock&&) = delete;
  // Removes the file.
  ~KeyLock();
  [[nodiscard]] bool held() const { return fd_.ok(); }

 private:
  UniqueFd fd_;
  std::filesystem::path file_;
};

}  // namespace stratalux::fit
