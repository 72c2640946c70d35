// SPDX-License-Identifier: Apache-2.0
// Sequencer: runs a capture plan on the rig's devices and proves each frame (docs/capture-plan.md).
//
//   load every projector's memory: pre-roll markers, then its own steps
//   all lights on, pre-roll, all lights off; the code must decode
//   for each projector: light on; each step shot, paired and checked while the next is exposed, what was spoilt shot
//                       again before the sequence goes on; light off
//   at the end: triggers and frames match one to one, comb cycles add up
//
// Whatever happens, all lights are off when Run returns.
#pragma once

#include <chrono>

#include "firmware-host/sequence/capture_observer.h"
#include "firmware-host/sequence/capture_report.h"
#include "firmware-host/sequence/frame_sink.h"
#include "firmware-host/sequence/pattern_witness.h"
#include "firmware-host/sequence/shooter.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

struct SequencerOptions {
  ShooterOptions shooter;
  WitnessOptions witness;
  int max_retries = 2;                   // further shots of a step; a third failure is hardly chance
  double min_preroll_contrast_dn = 5.0;  // mean level of white over dark markers
  // What fails at its last try as it did before has the reference asked whether the subject jumped; whose did is
  // captured by that projector anew. Asked at most so often in a session, and no more once the shots that a jump made
  // useless took so long, on the rig's clock.
  int max_reference_asks = 6;
  std::chrono::nanoseconds max_useless_time = std::chrono::seconds(6);
  // A rig that gives nothing is broken, not unlucky: this many shots in a row without a usable frame end the capture.
  int max_useless_shots = 10;
  // Longest time a projector's light may stay on at a stretch, on the rig's clock; 0: no limit.
  std::chrono::nanoseconds max_on_time = std::chrono::minutes(5);
  // What a step may take beyond its waits: our own computing, a disk that lets the sink wait. Light whose step takes
  // longer goes off (LightLease), and the capture fails.
  std::chrono::nanoseconds step_slack = std::chrono::milliseconds(500);

  [[nodiscard]] Status Validate() const;
  // From the begin of a step of this exposure to its frame in the sink.
  [[nodiscard]] std::chrono::nanoseconds LongestStep(double exposure_ms) const;
};

// kUsage where the plan asks for what these devices do not have; touches none of them.
[[nodiscard]] Status CheckFits(const CapturePlan& plan, const RigDevices& devices);
// kUsage where the plan shows waves and a projector's response is known and bent: a wave and its inverse add up to
// white only where light is in proportion to grey levels.
[[nodiscard]] Status CheckResponse(const CapturePlan& plan, const WitnessOptions& witness);

class Sequencer {
 public:
  // Ends within 20 ms of waiting once devices.light is stopped. `observer` may be null, and outlives the runs.
  Sequencer(RigDevices devices, SequencerOptions options, Logger& logger, CaptureObserver* observer = nullptr);

  // Fails with kUsage, before any light goes on, when the plan does not fit the devices. All later trouble is in the
  // report: status complete, degraded or failed, with findings. Frames go to the sink group by group, as they are
  // judged.
  Result<CaptureReport> Run(const CapturePlan& plan, FrameSink& sink);

 private:
  RigDevices devices_;
  SequencerOptions options_;
  Logger& logger_;
  CaptureObserver* observer_;
};

}  // namespace stratalux::rig
