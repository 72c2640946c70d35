// SPDX-License-Identifier: Apache-2.0
// The rig's configuration file (docs/examples/rig.toml): defaults < file < command-line flags.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/camera/camera_wiring.h"
#include "firmware-host/config/kiosk_config.h"
#include "firmware-host/gpio/gpio_wiring.h"
#include "firmware-host/projector/memory_layout.h"
#include "firmware-host/projector/memory_way.h"
#include "firmware-host/projector/projector_wiring.h"
#include "shared/base/result.h"
#include "shared/capture/plan.h"
#include "shared/config/store_config.h"
#include "shared/units/time.h"

namespace stratalux::rig {

inline constexpr double kLongestSettleMs = 10000.0;
inline constexpr int kLargestMemory = 1'000'000;  // patterns
inline constexpr double kShortestDeadlineMs = 1.0, kLongestDeadlineMs = 600000.0;
inline constexpr double kDeadlineMs = 500.0, kSyncDelayMs = 0.5;
// The light's guard has 99 (light_guard.h).
inline constexpr int kHighestCapturePriority = 98;

[[nodiscard]] CameraTiming CameraTimingOf(const CameraWiring& camera);

struct RigConfig {
  StoreConfig store;
  double settle_ms = 2.0;  // from SYNC to exposure
  // For a SYNC edge or a frame to arrive. Unset: as a selftest learnt (learnt_deadlines.h), else kDeadlineMs.
  std::optional<double> deadline_ms;
  std::optional<double> sync_delay_ms;  // from TRIGGER to SYNC, for estimates and the memory's shorter way
  double max_on_time_s = 60.0;          // longest a projector may stay lit without a pause
  double max_visit_s = 20.0;            // that a chosen exposure may make a visit take
  int max_retries = 2;                  // shots again of a doubtful frame
  int queue_frames = 32;                // between capture and writer
  std::string calibration;              // that sessions name: latest, an id or a file; empty: as `capture --help` says
  int realtime_priority = 0;  // of the capture thread under SCHED_FIFO, memory locked; 0: scheduled as all others
  PlanOptions plan;
  KioskConfig kiosk;
  MemoryOptions memory;  // what the projectors' pattern memories hold of it
  CameraWiring camera;
  GpioWiring gpio;
  std::vector<ProjectorWiring> projectors;  // one a [[projector]]; empty: a rig without devices (simulation)

  // The longest that any answer is awaited.
  [[nodiscard]] std::chrono::nanoseconds LongestDeadline() const {
    return FromMilliseconds(deadline_ms.value_or(kDeadlineMs));
  }
};

// What the movements of each projector's pattern memory take; nullopt: a display, which has none. Without
// [[projector]], all are memories.
[[nodiscard]] std::vector<std::optional<MemoryTiming>> MemoryTimingsOf(const RigConfig& config);

// kUsage with file:line for unreadable files, unknown keys, wrong types, values out of range and plans no projector can
// show.
[[nodiscard]] Result<RigConfig> LoadRigConfig(const std::filesystem::path& file);
[[nodiscard]] Result<RigConfig> ParseRigConfig(const std::string& text, const std::string& name);

}  // namespace stratalux::rig
