// SPDX-License-Identifier: Apache-2.0
// ControlPipe: what happens to a simulated rig, told from outside: lines of text into a FIFO (docs/simulated-rig.md).
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <thread>

#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {

struct Occurrence {
  RigSignal signal = RigSignal::kStart;
  SignalLevel level = SignalLevel::kActive;

  friend bool operator==(const Occurrence&, const Occurrence&) = default;
};

// One line without its end. kUsage names the words that there are.
[[nodiscard]] Result<Occurrence> ParseOccurrence(const std::string& line);

class ControlPipe {
 public:
  // Makes the FIFO (mode 0600), to be removed at the end, or takes one that is there: our own, and nobody else's to
  // write to; else kUsage. kBusy: another program reads it. Lines that are no occurrence, or longer than 200 bytes, are
  // answered in the log; what a writer that went left of a line is dropped. `rig` and `logger` outlive the pipe.
  static Result<std::unique_ptr<ControlPipe>> Open(const std::filesystem::path& path, SimulatedRig& rig,
                                                   Logger& logger);
  ~ControlPipe();
  ControlPipe(const ControlPipe&) = delete;
  ControlPipe& operator=(const ControlPipe&) = delete;

 private:
  ControlPipe(std::filesystem::path path, SimulatedRig& rig, Logger& logger)
      : path_(std::move(path)), rig_(rig), logger_(logger) {}
  // The FIFO, locked for us.
  Status Take();
  // A descriptor that knows of no writer yet.
  Status OpenForReading();
  void Listen();
  // False: the pipe cannot be read any more.
  bool ReadAll();
  void Hear(const std::string& bytes);
  void Obey(const std::string& line);

  const std::filesystem::path path_;
  SimulatedRig& rig_;
  Logger& logger_;
  bool made_ = false;
  UniqueFd held_;  // keeps the lock, and the pipe while no writer has it
  UniqueFd reading_, ending_;
  std::string line_;       // begun
  bool too_long_ = false;  // the line that is being read
  std::thread thread_;
};

}  // namespace stratalux::rig
