// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/service_notice.h"

#include <cstdint>

#include <systemd/sd-daemon.h>

namespace stratalux::rig {

ServiceNotice::ServiceNotice() {
  uint64_t watchdog_us = 0;
  if (sd_watchdog_enabled(0, &watchdog_us) > 0) pause_ = std::chrono::microseconds(watchdog_us / 2);
}

void ServiceNotice::Ready() const { sd_notify(0, "READY=1"); }
void ServiceNotice::Stopping() const { sd_notify(0, "STOPPING=1"); }

void ServiceNotice::State(const std::string& text) {
  if (text == state_) return;
  state_ = text;
  sd_notify(0, ("STATUS=" + text).c_str());
}

void ServiceNotice::Alive() {
  const auto now = std::chrono::steady_clock::now();
  if (pause_.count() == 0 || now < next_) return;
  next_ = now + pause_;
  sd_notify(0, "WATCHDOG=1");
}

}  // namespace stratalux::rig
