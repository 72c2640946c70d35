// SPDX-License-Identifier: Apache-2.0
// StateWriter: keeps a state file (state_file.h) on a thread of its own, so that nobody who has something to keep waits
// for a disk.
#pragma once

#include <condition_variable>
#include <filesystem>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

class StateWriter {
 public:
  // `logger` outlives it.
  StateWriter(std::filesystem::path file, Logger& logger);
  // Tries once more to write what is not written.
  ~StateWriter();
  StateWriter(const StateWriter&) = delete;
  StateWriter& operator=(const StateWriter&) = delete;

  // Soon on the disk, unless another one comes before. What cannot be written is tried again every ten seconds; that is
  // logged when it begins and when it is over.
  void Keep(std::string json);
  // Why the newest is not on the disk; empty: it is, or will be.
  [[nodiscard]] std::string trouble() const;

 private:
  void Work();
  void Note(const Status& kept);

  const std::filesystem::path file_;
  Logger& logger_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<std::string> waiting_;
  std::string trouble_;
  bool ending_ = false;
  std::thread thread_;
};

}  // namespace stratalux::rig
