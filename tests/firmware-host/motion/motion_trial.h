// SPDX-License-Identifier: Apache-2.0
// One projector's part of a visitor's capture on the simulated rig, by the real sequencer and witness, while the
// subject holds still or sways.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/simulated/simulated_rig.h"

namespace stratalux::rig {

struct MotionRigOptions {
  uint64_t seed = 1;  // another seed, another face, skin and noise
  int projector = 0;  // the one that is captured; the rig has four
  std::string scene = "head";
  bool scattering = true;
  int camera_width = 464, camera_height = 348;  // the projectors have their full size
  WitnessOptions witness;                       // gain and read noise are the camera's
  FaultOptions faults;                          // exposures are counted from the first capture's reference on
};

struct MotionCapture {
  SessionStatus status = SessionStatus::kFailed;
  int retried = 0;
  int unproven = 0;                    // steps
  int jumps = 0;                       // that had the projector captured anew
  std::vector<Finding> findings = {};  // what the session says
  double mean_sum = 0.0;               // of the comb cycle over white, one mean over all lit probes
  [[nodiscard]] bool Says(FindingKind kind) const;
};

class MotionRig {
 public:
  static Result<std::unique_ptr<MotionRig>> Create(const MotionRigOptions& options);

  // Without pre-roll: codes, sinusoids, a comb cycle with its whites, guards.
  Result<MotionCapture> Capture();
  [[nodiscard]] const CapturePlan& plan() const { return plan_; }
  // Index of the first comb in the plan, and of the last; white frames stand between.
  [[nodiscard]] int first_comb() const;
  [[nodiscard]] int last_comb() const;
  [[nodiscard]] SimulatedRig& rig() { return *rig_; }

 private:
  MotionRig() = default;
  Logger logger_{LogLevel::kError};
  CapturePlan plan_;
  WitnessOptions witness_;
  StopToken stop_;
  std::unique_ptr<SimulatedRig> rig_;
  std::unique_ptr<LightGuard> light_;
};

}  // namespace stratalux::rig
