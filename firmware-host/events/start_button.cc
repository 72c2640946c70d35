// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/events/start_button.h"

namespace stratalux::rig {

bool StartButton::OnEdge() {
  quiet_since_.reset();
  const bool pressed = armed_;
  armed_ = false;
  return pressed;
}

void StartButton::OnRest(MonotonicNs time) {
  if (!quiet_since_) quiet_since_ = time;
  if (time - *quiet_since_ >= kQuiet) armed_ = true;
}

}  // namespace stratalux::rig
