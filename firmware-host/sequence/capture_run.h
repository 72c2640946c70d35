// SPDX-License-Identifier: Apache-2.0
// CaptureRun: the state of one Sequencer::Run, from loading the pattern memories to the final proof. Private to this
// folder.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "firmware-host/sequence/preroll.h"
#include "firmware-host/sequence/sequencer.h"

namespace stratalux::rig {

class CaptureRun {
 public:
  CaptureRun(const CapturePlan& plan, RigDevices devices, const SequencerOptions& options, Logger& logger,
             const std::function<void()>& on_step, FrameSink& sink);

  // The whole capture; an error is why it failed. The report is valid in either case.
  Status Run();
  // Sets the final status and reasons; `ended` is what Run returned.
  CaptureReport Conclude(const Status& ended);

 private:
  Status LoadMemories();
  Status RunPreroll();
  Result<bool> ShootPreroll(const std::vector<int>& steps, int retry, std::vector<Shot>& shots);
  [[nodiscard]] PrerollReading ReadMarkers(const std::vector<Shot>& shots) const;
  Status RunProjector(int projector);
  // Shoots the steps (whole groups, ascending), then again those that the witness came to doubt.
  Status ShootBlock(std::vector<int> block);
  Status ShootSteps(const std::vector<int>& block);
  // Of the doubtful steps, those that may be shot again; the others fail.
  [[nodiscard]] std::vector<int> RetakeDoubtful(const std::vector<int>& doubtful);
  // Why to end here, if the light was taken away.
  Status CheckSafe();
  // The same, and another lease for the step that begins.
  Status BeginStep();
  [[nodiscard]] Status WhyDark(const Status& light) const;
  // One step of the block: position moves on, or back where something has to be shot again.
  Status ShootNext(const std::vector<int>& block, size_t& position);
  [[nodiscard]] bool RetriesLeft(int step) const {
    const auto found = retries_.find(step);
    return found == retries_.end() || found->second < options_.max_retries;
  }
  // Where the block's reference begins, if it may be shot again.
  [[nodiscard]] std::optional<size_t> ReferenceIn(const std::vector<int>& block) const;
  Status ShootReferenceAgain(const std::vector<int>& block, size_t position);
  Status JudgeGroup(const std::vector<int>& block, size_t& position);
  // After a spoilt shot of block[position]: reloads the memory from there, or from the next step once the step has had
  // its retries.
  Status ShootAgain(const std::vector<int>& block, size_t& position, ShotFault fault);
  // Frames or edges nobody asked for spoil the shot before `position`.
  Status DrainBefore(const std::vector<int>& block, size_t& position);
  Status Reload(const std::vector<int>& block, size_t position);
  Status Emit(Shot shot);
  void Advance(int step);
  Status SetLight(int projector, bool on);
  Status SetLights(bool on);
  [[nodiscard]] std::vector<int> StepsOf(int projector) const;
  [[nodiscard]] std::string Describe(int step) const;
  void CheckProof();

  const CapturePlan& plan_;
  RigDevices devices_;
  const SequencerOptions& options_;
  Logger& logger_;
  const std::function<void()>& on_step_;
  FrameSink& sink_;

  Shooter shooter_;
  PatternWitness witness_;
  CaptureReport report_;
  std::vector<Shot> held_;      // shots of the group that is not judged yet
  std::map<int, int> retries_;  // by step
  std::map<int, ShotFault> retake_cause_;
  std::map<int, FrameRecord> proven_;  // by step: the last good frame
  std::set<int> wrong_level_;          // steps whose last frame failed its level check
  bool memory_cut_ = false;            // the projector's memory ends with the steps of the block
  int silent_steps_ = 0;
  int furthest_step_ = -1;
  int64_t spoilt_triggers_ = 0;  // camera triggers without a frame in the sink
};

}  // namespace stratalux::rig
