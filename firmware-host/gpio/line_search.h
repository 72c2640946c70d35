// SPDX-License-Identifier: Apache-2.0
// Finds lines among the chips of this machine.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "firmware-host/gpio/gpio_wiring.h"
#include "shared/base/result.h"

namespace stratalux::rig {

enum class LineDirection : uint8_t { kInput, kOutput };

struct GpioLine {
  std::string name;  // empty: it has none
  LineDirection direction = LineDirection::kInput;
  bool in_use = false;     // by a program, or by a driver of the board
  std::string consumer{};  // what that calls itself; may be empty
};

struct GpioChip {
  std::string path;  // /dev/gpiochipN
  std::string label;
  std::vector<GpioLine> lines;  // by offset
};

struct FoundLine {
  std::string chip_path;
  unsigned offset = 0;

  friend bool operator==(const FoundLine&, const FoundLine&) = default;
};

// kNotFound: no such chip or line; kUsage: more than one. Both name what there is and how to go on.
[[nodiscard]] Result<FoundLine> FindLine(std::span<const GpioChip> chips, const LineAddress& address);

}  // namespace stratalux::rig
