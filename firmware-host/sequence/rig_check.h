// SPDX-License-Identifier: Apache-2.0
// Checks of a rig before anybody sits in it: are the lines wired as written, does each projector light up when told to
// and only then, does the camera answer each trigger once? Works on any devices; all lights are off afterwards.
#pragma once

#include <chrono>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/sequence/card_figures.h"
#include "firmware-host/sequence/deadlines.h"
#include "firmware-host/sequence/shooter.h"
#include "shared/base/result.h"

namespace stratalux::rig {

enum class CheckState { kPassed, kFailed, kSkipped };
[[nodiscard]] const char* ToString(CheckState state);  // "ok", "FAILED", "skipped"

struct CheckItem {
  std::string name;
  CheckState state = CheckState::kPassed;
  std::string found;   // what was measured
  std::string remedy;  // what to do about it; empty unless failed
};

struct RigCheckOptions {
  double exposure_ms = 16.0;
  double gain = 1.0;
  std::chrono::nanoseconds settle = std::chrono::milliseconds(2);
  std::chrono::nanoseconds deadline = std::chrono::milliseconds(500);  // of an edge, and of a frame after its exposure
  std::chrono::nanoseconds max_on_time = std::chrono::minutes(1);      // of a light at a stretch
  // What each projector's TRIGGER steps through: a sequence that every pattern memory holds (the plan's pre-roll), in
  // which a black picture is followed by a white one.
  std::vector<Pattern> markers;
  int pulses = 60;                                     // of each projector, for its delay: whole sequences
  int frames = 60;                                     // for rate, latency and delay
  double min_contrast_dn = 5.0;                        // mean level of a projector's white over its black
  std::function<void(std::chrono::nanoseconds)> wait;  // how settling passes; empty: real time
};

struct RigCheckReport {
  std::vector<CheckItem> items;
  std::vector<double> sync_latency_ms;   // TRIGGER to SYNC, all projectors
  std::vector<double> frame_latency_ms;  // camera TRIGGER to start of exposure; free running: frame to frame
  // What captures may take their deadlines from (DeadlinesFrom); nullopt where anything failed.
  std::optional<RigDelays> delays;
  int64_t frames_asked = 0, frames_lost = 0, frames_doubled = 0;
  double frames_per_s = 0.0;  // by the frames' own times
  // Of each projector; nullopt where its check came to none. sync_ms: median, TRIGGER to SYNC.
  std::vector<std::optional<CardFigures>> card;
  std::vector<std::optional<double>> sync_ms;
  std::vector<Image<uint16_t>> samples;  // some frames with light in them, for measuring codecs
  PixelFormat format = PixelFormat::kMono12;
  Cfa cfa = Cfa::kMono;
};

// A device error is an item that failed. kFailed with the reason once devices.light is stopped by
// more than the interlock.
[[nodiscard]] Result<RigCheckReport> CheckRig(const RigDevices& devices, const RigCheckOptions& options);

}  // namespace stratalux::rig
