// SPDX-License-Identifier: Apache-2.0
// systemd's end of sd_notify(3), for as long as it lives.
#pragma once

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <vector>

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "shared/base/unique_fd.h"

namespace stratalux::rig {

class NotifySocket {
 public:
  explicit NotifySocket(const std::filesystem::path& path, std::chrono::microseconds watchdog = {})
      : socket_(socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0)) {
    sockaddr_un at{};
    at.sun_family = AF_UNIX;
    path.string().copy(at.sun_path, sizeof at.sun_path - 1);
    if (bind(socket_.get(), reinterpret_cast<const sockaddr*>(&at), sizeof at) != 0)
      throw std::runtime_error("no socket at " + path.string());
    setenv("NOTIFY_SOCKET", path.c_str(), 1);
    setenv("WATCHDOG_PID", std::to_string(getpid()).c_str(), 1);
    if (watchdog.count() > 0) setenv("WATCHDOG_USEC", std::to_string(watchdog.count()).c_str(), 1);
  }
  ~NotifySocket() {
    for (const char* name : {"NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC"}) unsetenv(name);
  }
  NotifySocket(const NotifySocket&) = delete;
  NotifySocket& operator=(const NotifySocket&) = delete;

  // What has come, in order.
  std::vector<std::string> Take() {
    std::vector<std::string> all;
    char text[4096];
    for (ssize_t size = 0; (size = recv(socket_.get(), text, sizeof text, 0)) >= 0;)
      all.emplace_back(text, static_cast<size_t>(size));
    return all;
  }

 private:
  UniqueFd socket_;
};

}  // namespace stratalux::rig
