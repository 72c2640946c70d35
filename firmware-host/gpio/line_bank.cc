// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/gpio/line_bank.h"

namespace stratalux::rig {

const char* ToString(Interlock interlock) {
  switch (interlock) {
    case Interlock::kClosed:
      return "closed";
    case Interlock::kEmergencyStop:
      return "emergency stop";
    case Interlock::kDoorOpen:
      return "door open";
    case Interlock::kLinesGone:
      return "lines gone";
  }
  return "unknown";
}

}  // namespace stratalux::rig
