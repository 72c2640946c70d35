// SPDX-License-Identifier: Apache-2.0
// A subject who jumps in the midst of a projector's steps: none of what was proven before tells what is seen now, so
// the projector is captured anew, from its reference on.
#include <algorithm>
#include <utility>

#include "firmware-host/sequence/capture_run.h"

namespace stratalux::rig {

bool CaptureRun::MayHaveJumped(const PlanStep& last_of_group) const {
  // A try that differs from the one before is a fault of its own, or of a subject who does not hold still yet.
  return last_of_group.phase != CapturePhase::kReference && reference_asks_ < options_.max_reference_asks &&
         useless_time_ < options_.max_useless_time && witness_.FailsAsBefore(last_of_group);
}

Result<bool> CaptureRun::AskReference() {
  const PlanStep& failed = plan_.steps[*std::exchange(asking_, std::nullopt)];
  ++reference_asks_;
  std::vector<int> reference;
  for (const int step : StepsOf(failed.projector))
    if (plan_.steps[step].phase == CapturePhase::kReference && plan_.steps[step].bracket == 0)
      reference.push_back(step);
  std::vector<Shot> shots;
  if (reference.size() == 2) {  // white, black
    SLX_ASSIGN_OR_RETURN(shots, ShootReferenceAgain(reference));
  }
  // Where the memory stands, nothing has told.
  LoseMemory();
  std::optional<Finding> jump;
  if (!shots.empty())
    jump = witness_.FindJump(plan_.steps[reference[0]], shots[0].pixels, plan_.steps[reference[1]], shots[1].pixels);
  for (Shot& shot : shots) {
    // Without a jump the reference of before stands, by which all else was judged.
    shot.record.level_check = jump ? LevelCheck::kPassed : LevelCheck::kFailed;
    shot.record.retake_cause = ToString(jump ? ShotFault::kSubjectMoved : ShotFault::kWrongLevel);
    SLX_RETURN_IF_ERROR(Emit(std::move(shot)));
  }
  if (!jump) {
    SLX_RETURN_IF_ERROR(TellWhite(failed));
    return false;
  }
  logger_.Warning(Describe(failed.index) + ": the subject jumped; the projector is captured again");
  NoteFault(failed.index, ShotFault::kSubjectMoved);
  jump->step = failed.index;
  SLX_RETURN_IF_ERROR(Add(*jump));
  return true;
}

Result<std::vector<Shot>> CaptureRun::ShootReferenceAgain(const std::vector<int>& reference) {
  const int64_t triggers_before = shooter_.camera_triggers();
  std::vector<Shot> shots;
  SLX_RETURN_IF_ERROR(LoadFrom(reference.front()));
  for (const int step : reference) {
    // No try at the reference, whose proof stands until this one is judged.
    retries_from_[step] += 1;
    retries_[step] += 1;
    ++report_.retried;
    SLX_RETURN_IF_ERROR(BeginShot(step));
    SLX_ASSIGN_OR_RETURN(Shot shot, shooter_.Take(plan_.steps[step], retries_[step]));
    SLX_ASSIGN_OR_RETURN(const ShotFault unasked, shooter_.Drain());
    if (shot.fault == ShotFault::kNone) shot.fault = unasked;
    if (shot.fault != ShotFault::kNone) {
      NoteFault(step, shot.fault);
      spoilt_triggers_ += shooter_.camera_triggers() - triggers_before;
      SLX_RETURN_IF_ERROR(CountUseless());
      return std::vector<Shot>();
    }
    shots.push_back(std::move(shot));
  }
  useless_shots_ = 0;
  return shots;
}

Status CaptureRun::StartAgain(int projector) {
  useless_time_ += devices_.light.Now() - std::exchange(projector_begun_, devices_.light.Now());
  // Nobody looks at what still waits for its group.
  for (auto& [group, shots] : held_)
    for (Shot& shot : shots) shot.record.level_check = LevelCheck::kFailed;
  SLX_RETURN_IF_ERROR(EmitHeld());
  witness_.StartProjector(projector);
  last_kept_.reset();
  last_verdict_ = LevelCheck::kPassed;
  for (const int step : StepsOf(projector)) {
    proven_.erase(step);
    asked_.erase(step);
    given_up_.erase(step);
    wrong_level_.erase(step);
    told_whites_.erase(step);
    if (!retries_.contains(step)) continue;  // not begun yet
    Retake(step, ShotFault::kSubjectMoved);
    retries_from_[step] = retries_[step];
  }
  pending_.clear();  // the blocks fill it
  return Status::Ok();
}

Status CaptureRun::CheckAllProvenAnew(int projector) {
  for (const int step : StepsOf(projector)) {
    const bool proven = proven_.contains(step) && !wrong_level_.contains(step);
    // A motion white is of its own moment, whichever.
    if (proven || !retries_from_.contains(step) || plan_.steps[step].phase == CapturePhase::kMotion) continue;
    return EndFor(
        {FindingKind::kNoProof, projector, step, 0.0, 0.0,
         "after a jump of the subject this step was not proven anew; its frame of before is of another place"});
  }
  return Status::Ok();
}

}  // namespace stratalux::rig
