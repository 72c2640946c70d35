// SPDX-License-Identifier: Apache-2.0
// GpiodLineBank: the rig's lines on GPIO character devices (libgpiod, linux/gpio.h).
//
// All outputs are one request of one chip, all inputs another: lines of a request switch and are stamped together. A
// thread of its own watches the inputs; on E-STOP, DOOR or a chip that went it drops every ENABLE before it tells
// anybody. Edges are stamped by the kernel (CLOCK_MONOTONIC) and numbered by it line by line, so that one it had to
// drop leaves a gap.
#pragma once

#include <memory>

#include "firmware-host/gpio/gpio_wiring.h"
#include "firmware-host/gpio/line_bank.h"
#include "firmware-host/gpio/pattern_memory_lines.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

class GpiodLineBank : public LineBank, public PatternMemoryLines {
 public:
  // Takes the lines, everything off. An active E-STOP or open door is no error here, but the bank's first interlock.
  // kNotFound: no such line or chip; kUsage: a line of that name on several chips, outputs on two chips; kBusy: a line
  // in use, or a second bank in this process. A failed SLX_CHECK of this process drops every ENABLE, too.
  // The bank is thread-safe. When it goes, all its outputs are inactive.
  static Result<std::unique_ptr<GpiodLineBank>> Open(const GpioWiring& wiring, Logger& logger);
};

// `stratalux-rig safe`: every ENABLE line inactive, nothing else touched. kBusy where a running program holds the
// lines.
[[nodiscard]] Status DriveEnablesOff(const GpioWiring& wiring);

}  // namespace stratalux::rig
