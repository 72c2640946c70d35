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
             CaptureObserver& observer, FrameSink& sink);

  // The whole capture; an error is why it failed. The report is valid in either case.
  Status Run();
  // Hands on, not checked, what still waited for others of its group when the capture broke off.
  Status EmitHeld();
  // Sets the final status and findings; `ended` is what Run returned.
  CaptureReport Conclude(Status ended);

 private:
  static constexpr int kNoStep = -1;

  Status LoadMemories();
  Status RunPreroll();
  Result<bool> ShootPreroll(const std::vector<int>& steps, int retry, std::vector<Shot>& shots);
  [[nodiscard]] PrerollReading ReadMarkers(const std::vector<Shot>& shots) const;
  Status RunProjector(int projector);
  // kMoved: the subject jumped, and all of the projector's steps are to be shot again (StartAgain).
  enum class BlockEnd { kDone, kMoved };
  // Shoots the steps (whole groups, ascending); a spoilt one again before the next, those that came into doubt at the
  // end.
  Result<BlockEnd> ShootBlock(const std::vector<int>& block);
  // What goes on show next: where the memory stands if that step is pending, else the first that is; kNoStep: none.
  [[nodiscard]] int NextStep() const;
  // A frame that says nothing needs one behind it that does: only then is it known that the memory was in step.
  void AskWitness(int last_of_block);
  // Moves the projector on to the step and exposes it; looks at the frame before it.
  Status ShootNext(int step);
  // False where the exposed frame must be here before the projector moves on.
  [[nodiscard]] bool MayOverlap(int step) const;
  Status CollectExposed();
  // Its frame, unlooked at.
  Status Abandon(const StepExposure& exposure);
  Status Keep(Shot shot);
  Status JudgeGroup(const std::vector<int>& group);
  // A code by which the step would be judged could not be had: two faults that make up for each other would pass.
  [[nodiscard]] bool LacksCode(const PlanStep& step) const;
  // What is refuted before anything was confirmed speaks against the reference.
  bool RetakeReference(const std::vector<int>& refuted);
  // Whether a group that failed at its last try is worth a look at the reference: it showed the same at the try before.
  [[nodiscard]] bool MayHaveJumped(const PlanStep& last_of_group) const;
  // Shoots the reference again, one by one, in answer to `asking_`. True: the subject jumped, which is among the
  // findings. It says nothing where a shot of it is spoilt.
  Result<bool> AskReference();
  // Of the reference's steps; empty where one is spoilt.
  Result<std::vector<Shot>> ShootReferenceAgain(const std::vector<int>& reference);
  // As if nothing of the projector had been shot, but that retries go on counting.
  Status StartAgain(int projector);
  // Ends the capture where a step that counted before the jump has no frame since: nothing may mix the two places.
  Status CheckAllProvenAnew(int projector);
  // A SYNC edge nobody asked for: the projector moved on while the last frame was exposed.
  Status SpoilLast(ShotFault fault);
  // A shot that does not count: its step is shot again, or given up once it has had its retries.
  Status Spoil(int step, ShotFault fault);
  // What the projector's next pulse shows is not known any more.
  void LoseMemory();
  // Of shots without a usable frame, in a row: an error where the rig gives nothing any more.
  Status CountUseless();
  void Retake(int step, ShotFault cause);
  // Of the doubtful steps, those that may be shot again; the others fail.
  void RetakeDoubtful(const std::vector<int>& doubtful);
  // Of a projector's steps, codes that nothing bears out count no more: they may show other bits.
  void RefuteUnborneCodes(const std::vector<int>& steps);
  // Why to end here, if the light was taken away.
  Status CheckSafe();
  // The same, and another lease for what is done next.
  Status RenewLight();
  // The same before a shot, if the observer agrees.
  Status BeginShot(int step);
  // An error that ends the capture, and what it is.
  Status EndFor(Finding why);
  // A reference that cannot be had.
  Status EndWithoutReference(const PlanStep& step, const std::string& why);
  // A shot of the step that does not count.
  void NoteFault(int step, ShotFault fault);
  // Among the report's, and told.
  Status Add(Finding finding);
  // The observer may end the capture for it, which then is what the report says first.
  Status Tell(const Finding& finding);
  // A motion white that will not be shot again: the rest of the projector's steps need not be waited for.
  Status TellWhite(const PlanStep& white);
  [[nodiscard]] Status WhyDark(const Status& light) const;
  // Since the projector was begun, or begun anew.
  [[nodiscard]] int RetriesOf(int step) const {
    const auto found = retries_.find(step), from = retries_from_.find(step);
    return found == retries_.end() ? 0 : found->second - (from == retries_from_.end() ? 0 : from->second);
  }
  [[nodiscard]] bool RetriesLeft(int step) const { return RetriesOf(step) < options_.max_retries; }
  [[nodiscard]] bool AnyPending(const std::vector<int>& group) const;
  // Brings the projector's memory to where `step` comes next, in the dark.
  Status LoadFrom(int step);
  Status Emit(Shot shot);
  void Advance(int step);
  Status SetLight(int projector, bool on);
  Status SetLights(bool on);
  [[nodiscard]] std::vector<int> StepsOf(int projector) const;
  // The step that stands behind it in its projector's memory; kNoStep: none.
  [[nodiscard]] int StepAfter(int step) const;
  [[nodiscard]] std::string Describe(int step) const;
  Status CheckProof();

  const CapturePlan& plan_;
  RigDevices devices_;
  const SequencerOptions& options_;
  Logger& logger_;
  CaptureObserver& observer_;
  FrameSink& sink_;

  Shooter shooter_;
  PatternWitness witness_;
  CaptureReport report_;
  std::set<int> pending_;                // steps of the block that are still to be shot
  std::map<int, FrameRecord> asked_;     // steps that only speak for the one before: the proof they have
  std::set<int> given_up_;               // steps that had their retries without a usable frame
  std::optional<StepExposure> exposed_;  // the last step, until its frame is here
  std::optional<int> memory_at_;         // the step that the projector's next pulse shows; nullopt: not known
  std::optional<int> last_kept_;         // step of the last good frame of the projector
  LevelCheck last_verdict_ = LevelCheck::kNotChecked;
  std::map<int, std::vector<Shot>> held_;  // shots of groups that are not whole yet, by the group's first step
  std::map<int, int> retries_;             // by step, of those that were begun
  std::map<int, int> retries_from_;        // what they were when the projector was begun anew
  std::map<int, ShotFault> retake_cause_;
  std::map<int, FrameRecord> proven_;  // by step: the last good frame
  std::set<int> wrong_level_;          // steps whose last frame failed its level check
  int useless_shots_ = 0;              // in a row
  std::optional<int> asking_;          // last step of the group for which the reference is to be asked
  int reference_asks_ = 0;
  MonotonicNs projector_begun_;                                          // the present one, for the last time
  std::chrono::nanoseconds useless_time_ = std::chrono::nanoseconds(0);  // of what jumps made useless
  std::set<int> seen_;                                                   // steps that were told to the observer as done
  std::set<int> told_whites_;         // steps of motion whites whose finding the observer has
  std::optional<Finding> ended_for_;  // what ended the capture, where its error alone does not say
  int64_t spoilt_triggers_ = 0;       // camera triggers without a frame in the sink
};

}  // namespace stratalux::rig
