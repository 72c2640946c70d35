// SPDX-License-Identifier: Apache-2.0
// The steps of one projector: shot one while the other is read out, judged, and shot again where they must be.
#include <algorithm>
#include <utility>

#include "firmware-host/sequence/capture_run.h"

namespace stratalux::rig {

Result<CaptureRun::BlockEnd> CaptureRun::ShootBlock(const std::vector<int>& block) {
  if (block.empty()) return BlockEnd::kDone;
  pending_.insert(block.begin(), block.end());
  while (true) {
    if (!exposed_ && asking_) {
      SLX_ASSIGN_OR_RETURN(const bool jumped, AskReference());
      if (jumped) return BlockEnd::kMoved;
    }
    if (!exposed_) AskWitness(block.back());
    const int next = NextStep();
    if (exposed_ && (next == kNoStep || next != memory_at_ || !MayOverlap(next))) {
      SLX_RETURN_IF_ERROR(RenewLight());
      SLX_RETURN_IF_ERROR(shooter_.AwaitEnd(*exposed_));
      SLX_RETURN_IF_ERROR(CollectExposed());
      SLX_ASSIGN_OR_RETURN(const ShotFault fault, shooter_.DrainEdges());
      if (fault != ShotFault::kNone) SLX_RETURN_IF_ERROR(SpoilLast(fault));
      continue;
    }
    if (next == kNoStep) {
      RetakeDoubtful(witness_.TakeDoubtful());
      if (pending_.empty()) return BlockEnd::kDone;
      continue;
    }
    if (next != memory_at_) SLX_RETURN_IF_ERROR(LoadFrom(next));
    SLX_RETURN_IF_ERROR(ShootNext(next));
  }
}

int CaptureRun::NextStep() const {
  if (pending_.empty()) return kNoStep;
  return memory_at_ && pending_.contains(*memory_at_) ? *memory_at_ : *pending_.begin();
}

void CaptureRun::AskWitness(int last_of_block) {
  if (last_verdict_ != LevelCheck::kNotChecked || !last_kept_ || !memory_at_) return;
  const int next = *memory_at_;
  // What follows in the memory is shot anyway, here or in the next block.
  if (next == kNoStep || next > last_of_block || pending_.contains(next)) return;
  last_verdict_ = LevelCheck::kPassed;  // asked once
  if (!witness_.IsSpokenFor(plan_.steps[*last_kept_])) return;
  int speaker = next;
  while (speaker != kNoStep && speaker <= last_of_block && !witness_.CanSpeak(plan_.steps[speaker]))
    speaker = StepAfter(speaker);
  if (speaker == kNoStep || speaker > last_of_block) return;
  if (!RetriesLeft(next) || given_up_.contains(next)) return;
  const auto cause = retake_cause_.find(*last_kept_);
  const auto proven = proven_.find(next);
  if (proven != proven_.end()) asked_[next] = proven->second;
  Retake(next, cause == retake_cause_.end() ? ShotFault::kWrongLevel : cause->second);
}

bool CaptureRun::MayOverlap(int step) const {
  return plan_.options.sync_mode == SyncMode::kTriggered &&
         plan_.steps[step].exposure_ms == exposed_->step->exposure_ms;
}

Status CaptureRun::ShootNext(int step) {
  SLX_RETURN_IF_ERROR(BeginShot(step));
  if (exposed_) SLX_RETURN_IF_ERROR(shooter_.AwaitEnd(*exposed_));
  SLX_ASSIGN_OR_RETURN(const ShotFault fault, shooter_.DrainEdges());
  if (fault != ShotFault::kNone) return SpoilLast(fault);
  SLX_ASSIGN_OR_RETURN(std::optional<StepExposure> shown, shooter_.Show(plan_.steps[step], retries_[step]));
  // Two frames under way are told apart by their numbers.
  const bool serial = options_.shooter.camera.read_out == ReadOut::kSerial || !shooter_.CountsFrames();
  if (exposed_ && (serial || !shown)) SLX_RETURN_IF_ERROR(CollectExposed());
  if (!shown) return Spoil(step, ShotFault::kMissingSync);
  // That frame may have told that the projector is out of step.
  if (memory_at_ != step) return Status::Ok();
  memory_at_ = StepAfter(step);
  SLX_RETURN_IF_ERROR(shooter_.Expose(*shown));
  if (exposed_) {
    SLX_RETURN_IF_ERROR(CollectExposed());
    if (!memory_at_) return Abandon(*shown);
  }
  exposed_ = shown;
  return Status::Ok();
}

Status CaptureRun::Abandon(const StepExposure& exposure) {
  SLX_RETURN_IF_ERROR(RenewLight());
  ++spoilt_triggers_;
  SLX_RETURN_IF_ERROR(shooter_.Collect(exposure).status());
  return shooter_.DrainFrames().status();
}

Status CaptureRun::CollectExposed() {
  const StepExposure exposure = *std::exchange(exposed_, std::nullopt);
  SLX_ASSIGN_OR_RETURN(Shot shot, shooter_.Collect(exposure));
  if (shooter_.IsLast(exposure)) {
    SLX_ASSIGN_OR_RETURN(const ShotFault unasked, shooter_.DrainFrames());
    if (shot.fault == ShotFault::kNone) shot.fault = unasked;
  }
  if (shot.fault == ShotFault::kNone) return Keep(std::move(shot));
  last_kept_.reset();
  ++spoilt_triggers_;
  return Spoil(exposure.step->index, shot.fault);
}

Status CaptureRun::Keep(Shot shot) {
  const PlanStep& step = plan_.steps[shot.record.step];
  if (const auto cause = retake_cause_.find(step.index); cause != retake_cause_.end())
    shot.record.retake_cause = ToString(cause->second);
  useless_shots_ = 0;
  last_kept_ = step.index;
  pending_.erase(step.index);
  given_up_.erase(step.index);
  asked_.erase(step.index);
  witness_.Add(step, shot.pixels, shot.record.mean_dn);
  const std::vector<int> group = PatternWitness::GroupOf(plan_, step.index);
  std::vector<Shot>& held = held_[group.front()];
  // Nobody looks at a frame whose step was shot again before its group was whole, so it never counts.
  const auto older = std::find_if(held.begin(), held.end(), [&](const Shot& s) { return s.record.step == step.index; });
  if (older != held.end()) {
    Shot replaced = std::move(*older);
    held.erase(older);
    replaced.record.level_check = LevelCheck::kFailed;
    SLX_RETURN_IF_ERROR(Emit(std::move(replaced)));
  }
  held.push_back(std::move(shot));
  Advance(step.index);
  last_verdict_ = LevelCheck::kPassed;  // nothing to ask for before the group is whole
  return AnyPending(group) ? Status::Ok() : JudgeGroup(group);
}

Status CaptureRun::EmitHeld() {
  for (auto& [group, shots] : std::exchange(held_, {}))
    for (Shot& shot : shots) SLX_RETURN_IF_ERROR(Emit(std::move(shot)));
  return Status::Ok();
}

bool CaptureRun::AnyPending(const std::vector<int>& group) const {
  return std::any_of(group.begin(), group.end(), [this](int step) { return pending_.contains(step); });
}

Status CaptureRun::JudgeGroup(const std::vector<int>& group) {
  const PlanStep& last = plan_.steps[group.back()];
  // A group that lacks a member cannot be judged: what is there goes out as not checked, and stays refuted where it
  // was. Of those that tell nothing one by one, none counts.
  const bool whole = std::none_of(group.begin(), group.end(), [this](int step) { return given_up_.contains(step); });
  const bool refuted = wrong_level_.contains(last.index);
  const bool tells_nothing = !whole && !refuted && PatternWitness::OneLoadOf(plan_, last.index).size() > 1;
  const LevelCheck unjudged = refuted || tells_nothing ? LevelCheck::kFailed : LevelCheck::kNotChecked;
  LevelCheck verdict = whole ? witness_.Check(last) : unjudged;
  // Of a code that could not be had the witness still has frames that do not count: to agree with them proves nothing.
  const bool cannot_be_told = verdict != LevelCheck::kFailed && LacksCode(last);
  if (cannot_be_told) verdict = LevelCheck::kFailed;
  // Held no more, whether or not the sink takes them all: EmitHeld must not come upon what has gone out.
  std::vector<Shot> shots = std::exchange(held_[group.front()], {});
  held_.erase(group.front());
  for (Shot& shot : shots) {
    shot.record.level_check = verdict;
    SLX_RETURN_IF_ERROR(Emit(std::move(shot)));
  }
  last_verdict_ = verdict;
  if (tells_nothing || cannot_be_told) {
    for (int step : group) proven_.erase(step);
    return Status::Ok();
  }
  if (verdict != LevelCheck::kFailed) {
    for (int step : group) wrong_level_.erase(step);
    return TellWhite(last);
  }
  NoteFault(last.index, ShotFault::kWrongLevel);
  wrong_level_.insert(group.begin(), group.end());
  LoseMemory();
  if (!std::all_of(group.begin(), group.end(), [this](int step) { return RetriesLeft(step); })) {
    if (last.phase == CapturePhase::kReference && last.bracket == 0)
      return EndWithoutReference(last, "its frames do not show it at any try");
    if (!MayHaveJumped(last)) return TellWhite(last);
    asking_ = last.index;
    return Status::Ok();
  }
  if (RetakeReference(group)) return Status::Ok();
  logger_.Warning(Describe(last.index) + ": the frame does not show the pattern; shot again");
  for (int step : group) Retake(step, ShotFault::kWrongLevel);
  return Status::Ok();
}

bool CaptureRun::LacksCode(const PlanStep& step) const {
  const CapturePhase phase = step.phase;
  const bool judged_by_codes = phase == CapturePhase::kSeparation || phase == CapturePhase::kSweep ||
                               phase == CapturePhase::kSpot || phase == CapturePhase::kRepeat;
  return judged_by_codes && std::any_of(plan_.steps.begin(), plan_.steps.end(), [&](const PlanStep& code) {
           const bool of_it = code.projector == step.projector && code.phase == CapturePhase::kCorrespondence &&
                              code.bracket == 0 &&
                              (!step.pattern.IsOneDimensional() || code.pattern.axis == step.pattern.axis);
           const bool refuted = wrong_level_.contains(code.index) && !RetriesLeft(code.index);
           return of_it && (given_up_.contains(code.index) || refuted);
         });
}

bool CaptureRun::RetakeReference(const std::vector<int>& refuted) {
  const PlanStep& last = plan_.steps[refuted.back()];
  if (RetriesOf(last.index) == 0 || last.phase == CapturePhase::kReference || !witness_.ReferenceStandsAlone())
    return false;
  const std::vector<int> steps = StepsOf(last.projector);
  const auto reference = std::find_if(steps.begin(), steps.end(), [this](int step) {
    return plan_.steps[step].phase == CapturePhase::kReference && RetriesLeft(step);
  });
  if (reference == steps.end()) return false;
  logger_.Warning(Describe(*reference) + ": what follows contradicts the reference; it is shot again");
  for (int step : PatternWitness::GroupOf(plan_, *reference)) Retake(step, ShotFault::kWrongLevel);
  for (auto later = reference; later != steps.end() && *later <= last.index; ++later) pending_.insert(*later);
  return true;
}

Status CaptureRun::SpoilLast(ShotFault fault) {
  if (exposed_) {
    const StepExposure exposure = *std::exchange(exposed_, std::nullopt);
    SLX_RETURN_IF_ERROR(Abandon(exposure));
    return Spoil(exposure.step->index, fault);
  }
  LoseMemory();
  if (!last_kept_) {  // left over from before this projector's first shot: nothing of it is spoilt
    report_.Note(fault);
    logger_.Warning(std::string(ToString(fault)) + " before the first shot; the memory is loaded again");
    return CountUseless();
  }
  const int step = *std::exchange(last_kept_, std::nullopt);
  std::vector<Shot>& held = held_[PatternWitness::GroupOf(plan_, step).front()];
  spoilt_triggers_ += static_cast<int64_t>(std::erase_if(held, [&](const Shot& s) { return s.record.step == step; }));
  return Spoil(step, fault);
}

Status CaptureRun::Spoil(int step, ShotFault fault) {
  NoteFault(step, fault);
  proven_.erase(step);
  // Nothing was seen of what this frame would have told, so whether the memory is still in step is not known.
  LoseMemory();
  SLX_RETURN_IF_ERROR(CountUseless());
  if (const auto asked = asked_.find(step); asked != asked_.end()) {
    // It was only to speak for the frame before it, and has a frame of its own.
    proven_[step] = asked->second;
    asked_.erase(asked);
    pending_.erase(step);
    return Status::Ok();
  }
  if (RetriesLeft(step)) {
    for (int member : PatternWitness::OneLoadOf(plan_, step))
      if (member == step || !pending_.contains(member)) Retake(member, fault);
    logger_.Warning(Describe(step) + ": " + ToString(fault) + "; shot again");
    return Status::Ok();
  }
  logger_.Error(Describe(step) + ": " + ToString(fault) + " after " + std::to_string(options_.max_retries) +
                " retries; given up");
  if (plan_.steps[step].phase == CapturePhase::kReference && plan_.steps[step].bracket == 0)
    return EndWithoutReference(plan_.steps[step], std::string(ToString(fault)) + " at each try");
  pending_.erase(step);
  given_up_.insert(step);
  Advance(step);
  const std::vector<int> group = PatternWitness::GroupOf(plan_, step);
  return AnyPending(group) ? Status::Ok() : JudgeGroup(group);
}

void CaptureRun::LoseMemory() {
  memory_at_.reset();
  witness_.EndLoad();
}

Status CaptureRun::EndWithoutReference(const PlanStep& step, const std::string& why) {
  return EndFor({FindingKind::kNoProof, step.projector, step.index, 0.0, 0.0,
                 why + "; without this reference nothing can tell what the projector shows"});
}

Status CaptureRun::CountUseless() {
  if (++useless_shots_ < options_.max_useless_shots) return Status::Ok();
  return EndFor({FindingKind::kSilentRig, -1, -1, static_cast<double>(useless_shots_),
                 static_cast<double>(options_.max_useless_shots), report_.FaultSummary()});
}

void CaptureRun::Retake(int step, ShotFault cause) {
  ++retries_[step];
  ++report_.retried;
  retake_cause_[step] = cause;
  proven_.erase(step);
  pending_.insert(step);
}

void CaptureRun::RetakeDoubtful(const std::vector<int>& doubtful) {
  std::vector<int> again;
  for (int step : doubtful) {
    const std::vector<int> group = PatternWitness::GroupOf(plan_, step);
    if (std::all_of(group.begin(), group.end(), [this](int member) { return RetriesLeft(member); })) {
      again.push_back(step);
    } else if (!given_up_.contains(step)) {
      wrong_level_.insert(step);
      proven_.erase(step);
    }
  }
  if (again.empty()) return;
  NoteFault(again.front(), ShotFault::kWrongLevel);
  logger_.Warning(Describe(again.front()) + " and " + std::to_string(again.size() - 1) +
                  " more: the projector was out of step soon after; shot again");
  for (int step : again) Retake(step, ShotFault::kWrongLevel);
  LoseMemory();
}

void CaptureRun::RefuteUnborneCodes(const std::vector<int>& steps) {
  std::set<int> unproven;
  for (const int step : steps)
    if (!proven_.contains(step) || wrong_level_.contains(step)) unproven.insert(step);
  for (const int step : witness_.UnborneCodes(unproven)) {
    if (given_up_.contains(step)) continue;
    wrong_level_.insert(step);
    proven_.erase(step);
  }
}

}  // namespace stratalux::rig
