// SPDX-License-Identifier: Apache-2.0
// Logger and Progress: everything people read while work runs goes to stderr; stdout is data.
//
// Nobody who logs waits for whoever reads: a line goes into a bounded queue (shared/base/log_queue.h), a thread of the
// logger's own writes it. What finds the queue full is dropped and counted.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <initializer_list>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>

namespace stratalux {

class LogQueue;
class LogSink;

enum class LogLevel { kDebug, kInfo, kWarning, kError };

// The name of a field in the journal. A wrong one does not compile.
class LogFieldName {
 public:
  template <size_t kSize>
  consteval LogFieldName(const char (&name)[kSize]) : text_(name, kSize - 1) {  // NOLINT: meant to convert
    if (!IsAllowed(text_)) throw "a field is A-Z, 0-9 and _, a letter first, and none that every line has";
  }
  // What journald keeps (systemd.journal-fields), and not what every line already has.
  [[nodiscard]] static constexpr bool IsAllowed(std::string_view name) {
    const auto letter = [](char c) { return c >= 'A' && c <= 'Z'; };
    return !name.empty() && name.size() <= 64 && letter(name[0]) &&
           std::all_of(name.begin(), name.end(),
                       [&](char c) { return letter(c) || (c >= '0' && c <= '9') || c == '_'; }) &&
           name != "MESSAGE" && name != "PRIORITY" && name != "SYSLOG_IDENTIFIER";
  }
  [[nodiscard]] constexpr std::string_view text() const { return text_; }

 private:
  std::string_view text_;
};

struct LogField {
  LogFieldName name;
  std::string value;  // any bytes
};

// Writes "level: message" lines to a stream, with what would steer a terminal written out (PrintableLines); to
// systemd's journal with level and fields apart where stderr leads there ($JOURNAL_STREAM). Passed to whoever decides,
// never global. Thread-safe; not for signal handlers. After fork() the child goes on with an empty queue of its own:
// what the parent had queued is the parent's to write.
//
// The destructor waits at most a second for what is queued, then gives it up; exit() does so for every logger that is
// left. _exit(), an abort or a fatal signal lose what is queued.
class Logger {
 public:
  // `stream`: its descriptor is copied, so that the stream may be closed at any time. One without (a cookie, a buffer)
  // is written through stdio; it must outlive the logger, and the write in which it may have been stuck.
  explicit Logger(LogLevel threshold = LogLevel::kInfo, std::FILE* stream = stderr);
  Logger(LogLevel threshold, std::shared_ptr<LogSink> sink);
  ~Logger();
  Logger(const Logger&) = delete;
  Logger& operator=(const Logger&) = delete;
  void Debug(const std::string& message) { Write(LogLevel::kDebug, message); }
  void Info(const std::string& message) { Write(LogLevel::kInfo, message); }
  void Warning(const std::string& message) { Write(LogLevel::kWarning, message); }
  void Error(const std::string& message) { Write(LogLevel::kError, message); }
  // `fields` are for the journal alone; a stream shows the message.
  void Write(LogLevel level, const std::string& message, std::initializer_list<LogField> fields = {});
  // Waits until nothing is queued, at most a second (not again before the sink has taken something). False: something
  // still is.
  bool Flush();
  // Lines that were never written: the queue was full, or the sink is closed.
  [[nodiscard]] int64_t dropped() const;
  [[nodiscard]] bool Shows(LogLevel level) const { return level >= threshold_; }

 private:
  friend class Progress;

  LogLevel threshold_;
  std::unique_ptr<LogQueue> queue_;
};

// Flushes every logger of the process, all of them within a second: before something else writes to the same place.
bool FlushLoggers();
// `text`, with what would steer a terminal written out and nothing added, to stderr behind what the loggers hold. It is
// given up after a second.
void Say(LogLevel level, const std::string& text);

// A progress bar on a terminal, a line every 10 % elsewhere, in order with the logger's lines. One that finds no room
// is not drawn, nor counted as dropped. Thread-safe.
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
