// SPDX-License-Identifier: Apache-2.0
// What a projector is and how it is driven, as rig.toml says ([[projector]]; docs/hardware.md). Its lines stand in
// gpio/gpio_wiring.h; its size is the plan's.
#pragma once

#include <cstdint>
#include <string>

namespace stratalux::rig {

enum class ProjectorKind : uint8_t { kMemory, kDisplay };

// A projector that is a display of the computer (kms_display.h).
struct DisplayWiring {
  std::string device;     // such as /dev/dri/by-path/...; empty: the card that has the connector
  std::string connector;  // as the kernel names it, such as "HDMI-A-1"
  int width = 0;          // px; 0: as the plan's projectors
  int height = 0;
  double refresh_hz = 0.0;  // 0: the mode's highest
  double latency_ms = 0.0;  // from the flip to the light, calibrated
  double gamma = 1.0;       // light of level v of 255: (v / 255)^gamma

  friend bool operator==(const DisplayWiring&, const DisplayWiring&) = default;
};

struct ProjectorWiring {
  ProjectorKind kind = ProjectorKind::kMemory;
  DisplayWiring display;  // kDisplay alone
};

}  // namespace stratalux::rig
