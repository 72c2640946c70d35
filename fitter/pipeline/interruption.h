// SPDX-License-Identifier: Apache-2.0
// Ctrl-C leaves nothing half made: folders that are being made go with the process.
#pragma once

#include <filesystem>

#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::fit {

// Before the first thread: from now on INT, TERM and HUP remove what is registered, then end the process as they always
// do. What a killed process (KILL, a power cut) leaves, the next run removes.
void RemoveOnInterruption();

// Makes `root`/`folders`, level by level, and never `root`: a session that is forgotten while a run works on it stays
// gone. kFailed where it is.
[[nodiscard]] Status MakeFoldersBelow(const std::filesystem::path& root, const std::filesystem::path& folders);

// While it lives, the first of these signals asks instead of ending the process: what must be put in order first is.
// The next one ends it, but for those of the first 0.2 s, which are the same request. One at a time; needs
// RemoveOnInterruption().
class InterruptionAsks {
 public:
  InterruptionAsks();
  InterruptionAsks(const InterruptionAsks&) = delete;
  InterruptionAsks& operator=(const InterruptionAsks&) = delete;
  ~InterruptionAsks();
  // Readable once asked, for good; -1 where the system gives no descriptor: then the first signal ends the process.
  [[nodiscard]] int fd() const { return asked_.get(); }

 private:
  UniqueFd asked_;
};

// While it lives, the folder is one of those. Without RemoveOnInterruption() it does nothing. Thread-safe.
class RemovedOnSignal {
 public:
  explicit RemovedOnSignal(std::filesystem::path folder);
  RemovedOnSignal(const RemovedOnSignal&) = delete;
  RemovedOnSignal& operator=(const RemovedOnSignal&) = delete;
  ~RemovedOnSignal();

 private:
  std::filesystem::path folder_;
};

// While one lives, nothing is removed: what is being removed must get no name of what is whole, and nothing may be made
// anew behind its removal. For a moment only: Ctrl-C waits for it.
class NotInterrupted {
 public:
  NotInterrupted();
  NotInterrupted(const NotInterrupted&) = delete;
  NotInterrupted& operator=(const NotInterrupted&) = delete;
  ~NotInterrupted();
};

}  // namespace stratalux::fit
