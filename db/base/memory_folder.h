// SPDX-License-Identifier: Apache-2.0
// Files that lie in memory alone: what of an encrypted session must be plain for a while, and must not reach a disk.
// (Memory that is swapped out does reach one: docs/privacy.md.)
#pragma once

#include <filesystem>
#include <vector>

#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {

// /dev/shm, and $XDG_RUNTIME_DIR where it is set.
[[nodiscard]] std::vector<std::filesystem::path> MemoryRoots();

// Removes the folders of this account below `roots` whose process is gone: killed, it could not.
void RemoveAbandonedMemory(const std::vector<std::filesystem::path>& roots = MemoryRoots());

// A folder of this process alone (mode 0700) on tmpfs or ramfs, as statfs says; removed with all that is in it when it
// goes. Its process holds its lock (flock), by which others tell that it lives.
class MemoryFolder {
 public:
  // Below the root with the most room. kFailed, with the remedy, where none is of memory and may be written.
  // Removes abandoned ones, too.
  static Result<MemoryFolder> Create(const std::vector<std::filesystem::path>& roots = MemoryRoots());

  MemoryFolder(MemoryFolder&& other) noexcept = default;
  MemoryFolder& operator=(MemoryFolder&&) = delete;
  ~MemoryFolder();
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  // A failure of writing there as it is, and that the memory is full, where it is.
  [[nodiscard]] Status Explained(const Status& failure) const;

 private:
  MemoryFolder(std::filesystem::path path, UniqueFd lock) : path_(std::move(path)), lock_(std::move(lock)) {}
  std::filesystem::path path_;
  UniqueFd lock_;
};

}  // namespace stratalux::db
