// SPDX-License-Identifier: Apache-2.0
// GpiodLineBank: the rig's lines on GPIO character devices (libgpiod, linux/gpio.h).
//
// All outputs but ENABLE are one request of one chip, all inputs but E-STOP and DOOR another (those are GpioLights'):
// lines of a request switch and are stamped together. A thread of its own reads the inputs. Edges are stamped by the
// kernel (CLOCK_MONOTONIC) and numbered by it line by line, so that one it had to drop leaves a gap.
#pragma once

#include <memory>

#include "firmware-host/events/rig_events.h"
#include "firmware-host/gpio/gpio_wiring.h"
#include "firmware-host/gpio/line_bank.h"
#include "firmware-host/gpio/pattern_memory_lines.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

class GpiodLineBank : public LineBank, public PatternMemoryLines {
 public:
  // Takes the lines, everything inactive. kNotFound: no such line or chip; kUsage: a line of that name on several
  // chips, outputs on two chips; kBusy: a line in use.
  // The bank is thread-safe. When it goes, all its outputs are inactive. `events` is told of START (StartButton) and of
  // lost lines; it outlives the bank, and may be null.
  static Result<std::unique_ptr<GpiodLineBank>> Open(const GpioWiring& wiring, Logger& logger,
                                                     RigEvents* events = nullptr);
};

}  // namespace stratalux::rig
