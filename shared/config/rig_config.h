// SPDX-License-Identifier: Apache-2.0
// The rig's configuration file (docs/examples/rig.toml): defaults < file < command-line flags.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "shared/base/result.h"
#include "shared/capture/plan.h"
#include "shared/capture/session.h"
#include "shared/capture/store_codec.h"

namespace stratalux {

inline constexpr double kLongestSettleMs = 10000.0;

struct RigConfig {
  std::string name = "rig";
  std::string store;            // folder; empty: not set here
  std::optional<bool> encrypt;  // frames; unset: a kiosk does, a capture by hand does not
  int camera_width = 1392;
  int camera_height = 1042;
  double settle_ms = 2.0;       // from SYNC to exposure
  double deadline_ms = 2000.0;  // for a SYNC edge or a frame to arrive
  double max_on_time_s = 60.0;  // longest a projector may stay lit without a pause
  int max_retries = 2;          // shots again of a doubtful frame
  int queue_frames = 32;        // between capture and writer
  RetentionDays retention;      // of `stratalux-db purge`
  StoreCodec codec = StoreCodec::kDelta;
  PlanOptions plan;
};

// kUsage with file:line for unreadable files, unknown keys, wrong types, values out of range and plans no projector can
// show.
[[nodiscard]] Result<RigConfig> LoadRigConfig(const std::filesystem::path& file);
[[nodiscard]] Result<RigConfig> ParseRigConfig(const std::string& text, const std::string& name);

}  // namespace stratalux
