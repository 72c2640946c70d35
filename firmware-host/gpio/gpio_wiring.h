// SPDX-License-Identifier: Apache-2.0
// Which GPIO line carries which signal, as rig.toml says ([gpio], [[projector]]; docs/hardware.md).
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace stratalux::rig {

// A line by its name, or by its offset on the chip of a label. Never by the chip's number, which changes from boot to
// boot and from kernel to kernel.
struct LineAddress {
  std::string name;  // empty: by chip and offset
  std::string chip;  // label; empty: the name decides, on whatever chip
  int offset = -1;

  [[nodiscard]] std::string ToString() const;  // "GPIO17" or "pinctrl-rp1:17"
  friend bool operator==(const LineAddress&, const LineAddress&) = default;
};

enum class ActiveLevel : uint8_t { kHigh, kLow };
enum class LineBias : uint8_t { kAsIs, kDisabled, kPullUp, kPullDown };

struct OutputWiring {
  LineAddress at;
  ActiveLevel active = ActiveLevel::kHigh;

  friend bool operator==(const OutputWiring&, const OutputWiring&) = default;
};

struct InputWiring {
  LineAddress at;
  ActiveLevel active = ActiveLevel::kHigh;
  LineBias bias = LineBias::kAsIs;
  std::chrono::microseconds debounce{0};  // shorter pulses are no edge; 0: none
};

// Lines of one projector. A pattern memory needs the first three; a display may do with none.
struct ProjectorLines {
  std::optional<OutputWiring> enable, trigger;
  std::optional<InputWiring> sync;
  std::optional<OutputWiring> reset;  // of a pattern memory: rewinds it
};

struct GpioWiring {
  std::vector<ProjectorLines> projectors;
  std::optional<OutputWiring> camera_trigger;
  std::optional<InputWiring> strobe, emergency_stop, door, start;
  std::chrono::microseconds projector_pulse{200}, camera_pulse{100}, reset_pulse{10000};

  // No line at all is wired.
  [[nodiscard]] bool empty() const;
};

}  // namespace stratalux::rig
