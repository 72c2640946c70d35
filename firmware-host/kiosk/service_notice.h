// SPDX-License-Identifier: Apache-2.0
// What systemd is told of a service (Type=notify, WatchdogSec): the datagrams of sd_notify(3). Silent where nobody
// listens ($NOTIFY_SOCKET). libsystemd's own sender waits while the socket is full, which would hold up who steps the
// machine; this one never waits, and tells later what could not be told.
#pragma once

#include <chrono>
#include <string>

#include "shared/base/unique_fd.h"

namespace stratalux::rig {

class ServiceNotice {
 public:
  // By $NOTIFY_SOCKET, $WATCHDOG_USEC and $WATCHDOG_PID as they are now.
  ServiceNotice();
  void Ready();
  void Stopping();
  // For `systemctl status`; told on where it is another one.
  void State(const std::string& text);
  // That there was progress; told on when half the watchdog's time is over, so that it may be called at any pace. With
  // it what could not be told before.
  void Alive();

 private:
  // False: nobody took it, now.
  [[nodiscard]] bool Send(const std::string& text) const;
  void SendWaiting();

  UniqueFd socket_;
  std::string address_;                 // a path, or "@" and an abstract name; empty: nobody listens
  std::chrono::microseconds pause_{0};  // 0: no watchdog
  std::chrono::steady_clock::time_point next_;
  std::string state_;
  std::string waiting_once_, waiting_state_;  // READY=1 or STOPPING=1; the last STATUS
};

}  // namespace stratalux::rig
