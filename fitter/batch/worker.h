// SPDX-License-Identifier: Apache-2.0
// A visitor's fit in a process of its own: it may crash, hang or eat memory without the night going with it.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

#include "db/keys/key_store.h"
#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::fit {

struct WorkerOptions {
  std::vector<std::string> command;  // [0]: the program's file
  std::filesystem::path log;         // receives stdout and stderr, what was in it is kept
  int threads = 1;                   // STRATALUX_THREADS
  int nice = 10;                     // added to this process's; the disk is asked for when nobody else does
  // Of its visitor, if encrypted: the worker gets it through a pipe (db/keys/held_keys.h), and no key of a reader.
  std::vector<db::SessionKey> keys = {};
};

struct WorkerEnd {
  int exit_code = -1;  // -1: a signal ended it
  int signal = 0;
  double cpu_seconds = 0.0;
  int64_t peak_bytes = 0;  // resident
};

// Ends with this process, also by SIGKILL.
class Worker {
 public:
  // kFailed where no process could be made or the program is not there.
  [[nodiscard]] static Result<Worker> Start(const WorkerOptions& options);
  Worker() = default;  // none
  Worker(Worker&& other) noexcept;
  Worker& operator=(Worker&& other) noexcept;
  // Killed, if it still runs.
  ~Worker();

  [[nodiscard]] pid_t pid() const { return pid_; }
  // Readable once it has ended.
  [[nodiscard]] int fd() const { return ended_.get(); }
  // Never waits.
  [[nodiscard]] std::optional<WorkerEnd> Ended();
  [[nodiscard]] int64_t ResidentBytes() const;
  [[nodiscard]] std::chrono::steady_clock::duration Age() const { return std::chrono::steady_clock::now() - started_; }
  void Signal(int signal) const;

 private:
  Worker(pid_t pid, UniqueFd ended) : pid_(pid), ended_(std::move(ended)) {}

  pid_t pid_ = -1;  // -1: nothing to wait for
  UniqueFd ended_;
  std::chrono::steady_clock::time_point started_ = std::chrono::steady_clock::now();
};

}  // namespace stratalux::fit
