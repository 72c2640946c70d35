// SPDX-License-Identifier: Apache-2.0
// Logger and Progress: everything people read while work runs goes to stderr; stdout is data.
#pragma once

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <mutex>
#include <string>

namespace stratalux {

enum class LogLevel { kDebug, kInfo, kWarning, kError };

// Writes "level: message" lines to a stream, with what would steer a terminal written out (PrintableLines).
// Thread-safe. Passed to whoever decides, never global.
class Logger {
 public:
  explicit Logger(LogLevel threshold = LogLevel::kInfo, std::FILE* stream = stderr)
      : threshold_(threshold), stream_(stream) {}
  void Debug(const std::string& message) { Write(LogLevel::kDebug, message); }
  void Info(const std::string& message) { Write(LogLevel::kInfo, message); }
  void Warning(const std::string& message) { Write(LogLevel::kWarning, message); }
  void Error(const std::string& message) { Write(LogLevel::kError, message); }
  void Write(LogLevel level, const std::string& message);
  [[nodiscard]] std::FILE* stream() const { return stream_; }
  [[nodiscard]] bool Shows(LogLevel level) const { return level >= threshold_; }

 private:
  LogLevel threshold_;
  std::FILE* stream_;
  std::mutex mutex_;
};

// A progress bar on a terminal, a line every 10 % elsewhere. Thread-safe.
class Progress {
 public:
  Progress(Logger& logger, std::string label, int64_t total);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  void Advance(int64_t steps = 1);

 private:
  void Draw(bool final);

  Logger& logger_;
  std::string label_;
  int64_t total_;
  int64_t done_ = 0;
  int64_t last_drawn_percent_ = -1;
  bool terminal_;
  std::chrono::steady_clock::time_point start_;
  std::mutex mutex_;
};

}  // namespace stratalux
