// SPDX-License-Identifier: Apache-2.0
// Shooter: one planned step = one projector pulse, one SYNC edge, one camera pulse, one frame, each by its deadline.
#pragma once

#include <chrono>
#include <functional>
#include <optional>
#include <vector>

#include "firmware-host/camera/frame_source.h"
#include "firmware-host/gpio/line_bank.h"
#include "firmware-host/projector/projector.h"
#include "firmware-host/sequence/capture_report.h"
#include "firmware-host/sequence/frame_pairing.h"
#include "shared/capture/frame_record.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

struct RigDevices {
  LineBank& lines;
  FrameSource& camera;
  std::vector<Projector*> projectors;
};

struct ShooterOptions {
  // From SYNC to the camera trigger: the projector's light source and the camera's own trigger delay.
  std::chrono::nanoseconds settle = std::chrono::milliseconds(2);
  std::chrono::nanoseconds sync_deadline = std::chrono::milliseconds(100);
  std::chrono::nanoseconds frame_deadline = std::chrono::milliseconds(500);  // on top of the exposure
  std::chrono::nanoseconds frame_slack = std::chrono::milliseconds(20);      // of the frame's time after its trigger
  double gain = 1.0;
  // How `settle` passes. The simulated rig, whose clock is its own, passes an empty wait.
  std::function<void(std::chrono::nanoseconds)> wait;
};

// A frame and its proof; `fault` says why it does not count.
struct Shot {
  ShotFault fault = ShotFault::kNone;
  FrameRecord record;
  Image<uint16_t> pixels;
};

class Shooter {
 public:
  Shooter(RigDevices devices, ShooterOptions options);

  // Fails only where going on is pointless (a device error, a frame of an unknown clock or of another size); what a
  // second try may heal is a fault.
  Result<Shot> Take(const PlanStep& step, int retry);
  // Reads away what came unasked since the last shot: kDoubledFrame, kExtraSync or kOutOfOrder spoil that last shot.
  Result<ShotFault> Drain();
  // Time of the last camera trigger, on the rig's clock.
  [[nodiscard]] MonotonicNs last_trigger() const { return last_trigger_; }
  [[nodiscard]] int64_t camera_triggers() const { return camera_triggers_; }

 private:
  // Waits for the SYNC edges of `projector` (-1: one of each); nullopt at the deadline.
  Result<std::optional<MonotonicNs>> AwaitSync(int projector, const TriggerReceipt& trigger);
  Result<Shot> AwaitFrame(const PlanStep& step, const TriggerReceipt& trigger);
  Status CheckFrame(const CapturedFrame& frame);

  RigDevices devices_;
  ShooterOptions options_;
  FramePairing pairing_;
  double exposure_ms_ = -1.0;  // as last set
  MonotonicNs last_trigger_;
  int64_t camera_triggers_ = 0;
  std::optional<CapturedFrame> first_;  // without pixels: size, format and clock every later frame must share
  int first_width_ = 0;
  int first_height_ = 0;
};

}  // namespace stratalux::rig
