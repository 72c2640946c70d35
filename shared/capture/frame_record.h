// SPDX-License-Identifier: Apache-2.0
// The proof of a frame: one row per captured frame, enough to show which pattern it holds.
#pragma once

#include <cstdint>
#include <string>

#include "shared/capture/plan.h"
#include "shared/image/pixel_format.h"
#include "shared/units/time.h"

namespace stratalux {

enum class LevelCheck : uint8_t { kNotChecked = 0, kPassed = 1, kFailed = 2 };

struct FrameRecord {
  int step = 0;  // planned step (PlanStep::index)
  int projector = -1;
  CapturePhase phase = CapturePhase::kReference;
  Pattern pattern;
  int bracket = 0;
  int pose = -1;             // calibration sessions: board pose; else -1
  int retry = 0;             // 0 = first shot
  std::string retake_cause;  // why the shot before this one did not count (up to 31 characters); empty for a first shot
  int64_t trigger_number = -1;
  MonotonicNs trigger_time;
  MonotonicNs sync_time;  // projector's SYNC edge; 0 where the device has none
  int64_t driver_sequence = -1;
  MonotonicNs frame_time;
  ClockSource frame_clock = ClockSource::kUnknown;
  double exposure_ms = 0.0;  // as reported by the camera
  double gain = 1.0;
  LevelCheck level_check = LevelCheck::kNotChecked;
  double mean_dn = 0.0;  // mean raw level, for the level check
  // Payload.
  PixelFormat format = PixelFormat::kMono12;
  Cfa cfa = Cfa::kRggb;
  int width = 0;
  int height = 0;
  int channels = 1;
  int crop_x = 0;  // of a cropped import within the camera's full frame
  int crop_y = 0;
};

}  // namespace stratalux
