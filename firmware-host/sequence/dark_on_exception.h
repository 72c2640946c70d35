// SPDX-License-Identifier: Apache-2.0
// What no Status tells: an exception of a library, or for memory.
#pragma once

#include <exception>

#include "firmware-host/sequence/shooter.h"

namespace stratalux::rig {

// While it lives, an exception that passes leaves no light on and no camera running: whoever catches it may take long,
// and a lease is a second and more.
class DarkOnException {
 public:
  explicit DarkOnException(const RigDevices& devices) : light_(devices.light), camera_(devices.camera) {}
  DarkOnException(const DarkOnException&) = delete;
  DarkOnException& operator=(const DarkOnException&) = delete;
  ~DarkOnException() {
    if (std::uncaught_exceptions() <= before_) return;
    try {
      static_cast<void>(light_.AllOff().ok());  // the guard goes on trying
      static_cast<void>(camera_.Stop().ok());
    } catch (...) {  // NOLINT(bugprone-empty-catch): the first one is on its way
    }
  }

 private:
  LightGuard& light_;
  FrameSource& camera_;
  const int before_ = std::uncaught_exceptions();
};

}  // namespace stratalux::rig
