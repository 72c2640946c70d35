// SPDX-License-Identifier: Apache-2.0
#include "shared/base/log_sink.h"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstdlib>

#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include "shared/base/printable.h"
#include "shared/base/unique_fd.h"

namespace stratalux {
namespace {

class TextSink : public LogSink {
 public:
  explicit TextSink(bool is_stderr) : name_(is_stderr ? "stderr" : "the log") {}
  [[nodiscard]] std::string Format(LogLevel level, const std::string& message,
                                   std::span<const LogField> /*fields*/) const override {
    static constexpr const char* kNames[] = {"debug: ", "info: ", "warning: ", "error: "};
    return kNames[static_cast<int>(level)] + message + "\n";
  }
  [[nodiscard]] std::string Plain(LogLevel /*level*/, const std::string& text) const override { return text; }
  [[nodiscard]] std::string name() const override { return name_; }

 private:
  std::string name_;
};

// The descriptor is shared with other processes, so O_NONBLOCK is not ours to set. A pipe that polls writable takes
// PIPE_BUF bytes at once unless another writer is faster; a terminal may stop (Ctrl-S) and a disk freeze in between:
// then this thread waits, and nobody else.
class DescriptorSink final : public TextSink {
 public:
  DescriptorSink(UniqueFd fd, bool is_stderr) : TextSink(is_stderr), fd_(std::move(fd)) {}
  Taken Take(std::string_view& rest, std::chrono::milliseconds patience) override {
    if (!fd_.ok()) return Taken::kNever;
    pollfd room = {fd_.get(), POLLOUT, 0};
    const int ready = poll(&room, 1, static_cast<int>(patience.count()));
    if (ready == 0 || (ready < 0 && errno == EINTR)) return Taken::kNotYet;
    if (ready < 0 || (room.revents & POLLNVAL) != 0) return Taken::kNever;
    const ssize_t written = write(fd_.get(), rest.data(), std::min<size_t>(rest.size(), PIPE_BUF));
    if (written < 0) return errno == EINTR || errno == EAGAIN ? Taken::kNotYet : Taken::kNever;
    rest.remove_prefix(static_cast<size_t>(written));
    return rest.empty() ? Taken::kAll : Taken::kNotYet;
  }
  [[nodiscard]] bool IsTerminal() const override { return isatty(fd_.get()) != 0; }

 private:
  UniqueFd fd_;
};

// A stream without a descriptor.
class StdioSink final : public TextSink {
 public:
  explicit StdioSink(std::FILE* stream) : TextSink(false), stream_(stream) {}
  Taken Take(std::string_view& rest, std::chrono::milliseconds /*patience*/) override {
    const bool all = std::fwrite(rest.data(), 1, rest.size(), stream_) == rest.size() && std::fflush(stream_) == 0;
    std::clearerr(stream_);
    rest = {};
    return all ? Taken::kAll : Taken::kNever;
  }

 private:
  std::FILE* stream_;
};

}  // namespace

std::shared_ptr<LogSink> SinkFor(std::FILE* stream) {
  const int fd = fileno(stream);
  const bool is_stderr = stream == stderr;
  if (is_stderr && IsJournal(fd, std::getenv("JOURNAL_STREAM")))
    if (std::shared_ptr<LogSink> journal = JournalSink()) return journal;
  if (fd < 0 && !is_stderr) return std::make_shared<StdioSink>(stream);
  // A closed stderr stays closed for this logger, whatever file is opened under its number later.
  return std::make_shared<DescriptorSink>(UniqueFd(fcntl(fd, F_DUPFD_CLOEXEC, 3)), is_stderr);
}

}  // namespace stratalux
