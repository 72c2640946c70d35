// SPDX-License-Identifier: Apache-2.0
// Where lines go: a stream, or systemd's journal.
#pragma once

#include <chrono>
#include <cstdio>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "shared/base/log.h"

namespace stratalux {

// Format() and Plain() are called by whoever logs, from any thread; Take() by the queue's thread alone.
class LogSink {
 public:
  virtual ~LogSink() = default;

  // The bytes of one line.
  [[nodiscard]] virtual std::string Format(LogLevel level, const std::string& message,
                                           std::span<const LogField> fields) const = 0;
  // The bytes of a text that is shown as it is: progress, prompts.
  [[nodiscard]] virtual std::string Plain(LogLevel level, const std::string& text) const = 0;

  enum class Taken { kAll, kNotYet, kNever };
  // Removes from `rest` what it took of it, waiting for room no longer than `patience` where the kernel tells. kNever:
  // the rest will not be taken either (closed, too long).
  virtual Taken Take(std::string_view& rest, std::chrono::milliseconds patience) = 0;

  // Whether several lines may be handed over as one text.
  [[nodiscard]] virtual bool JoinsLines() const { return true; }
  [[nodiscard]] virtual bool IsTerminal() const { return false; }
  [[nodiscard]] virtual std::string name() const = 0;
};

// The journal, if `stream` is stderr and leads there; otherwise the stream.
[[nodiscard]] std::shared_ptr<LogSink> SinkFor(std::FILE* stream);

// Whether `journal_stream` ($JOURNAL_STREAM, may be null) says that descriptor `fd` is a stream of the journal: its
// device and inode numbers as "device:inode" (systemd.exec).
[[nodiscard]] bool IsJournal(int fd, const char* journal_stream);

inline constexpr const char* kJournalSocket = "/run/systemd/journal/socket";
// Speaks the journal's native protocol (systemd.io/JOURNAL_NATIVE_PROTOCOL): a datagram a line. Opens the socket again
// when journald was started anew. Null: nobody listens at `socket`.
[[nodiscard]] std::shared_ptr<LogSink> JournalSink(const std::string& socket = kJournalSocket);

}  // namespace stratalux
