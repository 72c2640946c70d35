// SPDX-License-Identifier: Apache-2.0
// The bounded queue between those who log and a sink that may be slow or stuck for ever.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "shared/base/log_sink.h"

namespace stratalux {

// One thread, started with the first line, writes to the sink. It has ordinary priority, whatever the priority of the
// one who logged first, and blocks all signals but those of a crash: a SIGPIPE by write() goes to the thread that
// wrote, so it stays pending here and the process's own handling of SIGPIPE is left alone.
//
// A stuck sink leaves the thread behind: it owns its state and ends with the process. Thread-safe.
class LogQueue {
 public:
  // Whatever the sink has not taken counts.
  static constexpr size_t kMaxLines = 4096;
  static constexpr size_t kMaxBytes = 1 << 20;
  static constexpr std::chrono::milliseconds kPatience{1000};

  // kProgress: dropped without being counted.
  enum class Kind { kLine, kProgress };

  explicit LogQueue(std::shared_ptr<LogSink> sink);
  ~LogQueue();
  LogQueue(const LogQueue&) = delete;
  LogQueue& operator=(const LogQueue&) = delete;

  // Never waits for the sink. A full queue drops `bytes`; how many lines were dropped stands where they would have.
  void Push(std::string bytes, Kind kind);
  // Logger::Flush, until `deadline`.
  bool Flush(std::chrono::steady_clock::time_point deadline);
  [[nodiscard]] int64_t dropped() const;
  [[nodiscard]] const LogSink& sink() const;

 private:
  struct State;
  struct Registry;
  friend bool FlushLoggers();

  static Registry& TheRegistry();
  static void StartAfreshInChild();

  std::shared_ptr<State> state_;
};

}  // namespace stratalux
