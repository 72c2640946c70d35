// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <thread>

#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include "shared/base/log_sink.h"
#include "shared/base/unique_fd.h"

namespace stratalux {
namespace {

// NAME=value; with line ends in it, the name alone in a line, then the length in 8 bytes, little-endian, and the value.
void AppendField(std::string& datagram, std::string_view name, std::string_view value) {
  datagram += name;
  if (value.find('\n') == std::string_view::npos) {
    datagram += '=';
  } else {
    datagram += '\n';
    for (unsigned shift = 0; shift < 64; shift += 8) datagram += static_cast<char>(value.size() >> shift & 0xffU);
  }
  datagram += value;
  datagram += '\n';
}

UniqueFd Connected(const std::string& path) {
  sockaddr_un address = {};
  address.sun_family = AF_UNIX;
  if (path.size() >= sizeof address.sun_path) return {};
  path.copy(address.sun_path, path.size());
  UniqueFd fd(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  if (connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) return {};
  return fd;
}

class Journal final : public LogSink {
 public:
  Journal(std::string path, UniqueFd fd) : path_(std::move(path)), fd_(std::move(fd)) {}

  [[nodiscard]] std::string Format(LogLevel level, const std::string& message,
                                   std::span<const LogField> fields) const override {
    static constexpr std::array<const char*, 4> kPriorities = {"7", "6", "4", "3"};  // of syslog
    std::string datagram;
    AppendField(datagram, "PRIORITY", kPriorities[static_cast<size_t>(level)]);
    AppendField(datagram, "SYSLOG_IDENTIFIER", program_invocation_short_name);
    AppendField(datagram, "MESSAGE", message);
    for (const LogField& field : fields) AppendField(datagram, field.name.text(), field.value);
    return datagram;
  }
  [[nodiscard]] std::string Plain(LogLevel level, const std::string& text) const override {
    return Format(level, text.substr(0, text.find_last_not_of('\n') + 1), {});
  }
  Taken Take(std::string_view& rest, std::chrono::milliseconds patience) override {
    if (fd_.get() < 0) fd_ = Connected(path_);
    const ssize_t sent = send(fd_.get(), rest.data(), rest.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
    if (sent >= 0) {
      rest = {};
      return Taken::kAll;
    }
    if (errno == EMSGSIZE) return Taken::kNever;
    if (errno == EAGAIN || errno == ENOBUFS) {
      pollfd room = {fd_.get(), POLLOUT, 0};
      if (poll(&room, 1, static_cast<int>(patience.count())) > 0 && (room.revents & POLLERR) == 0)
        return Taken::kNotYet;
    }
    // journald is gone or starts anew.
    fd_ = Connected(path_);
    if (fd_.get() < 0) std::this_thread::sleep_for(patience);
    return Taken::kNotYet;
  }
  [[nodiscard]] bool JoinsLines() const override { return false; }
  [[nodiscard]] std::string name() const override { return "the journal"; }

 private:
  std::string path_;
  UniqueFd fd_;
};

}  // namespace

bool IsJournal(int fd, const char* journal_stream) {
  struct stat status = {};
  if (journal_stream == nullptr || fstat(fd, &status) != 0) return false;
  const char* end = journal_stream + std::strlen(journal_stream);
  uint64_t device = 0, inode = 0;
  const auto [colon, wrong_device] = std::from_chars(journal_stream, end, device);
  if (wrong_device != std::errc() || colon == end || *colon != ':') return false;
  const auto [rest, wrong_inode] = std::from_chars(colon + 1, end, inode);
  return wrong_inode == std::errc() && rest == end && device == status.st_dev && inode == status.st_ino;
}

std::shared_ptr<LogSink> JournalSink(const std::string& socket) {
  UniqueFd fd = Connected(socket);
  if (fd.get() < 0) return nullptr;
  return std::make_shared<Journal>(socket, std::move(fd));
}

}  // namespace stratalux
