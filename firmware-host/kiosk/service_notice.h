// SPDX-License-Identifier: Apache-2.0
// What systemd is told of a service (Type=notify, WatchdogSec). Silent where nobody listens ($NOTIFY_SOCKET).
#pragma once

#include <chrono>
#include <string>

namespace stratalux::rig {

class ServiceNotice {
 public:
  ServiceNotice();
  void Ready() const;
  void Stopping() const;
  // For `systemctl status`; told on where it is another one.
  void State(const std::string& text);
  // That there was progress; told on when half the watchdog's time is over, so that it may be called at any pace.
  void Alive();

 private:
  std::chrono::microseconds pause_{0};  // 0: no watchdog
  std::chrono::steady_clock::time_point next_;
  std::string state_;
};

}  // namespace stratalux::rig
