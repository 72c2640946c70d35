// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/capture_run.h"

#include <algorithm>
#include <utility>

namespace stratalux::rig {

namespace {

// A camera said to have no noise (a test pattern, a simulation without it) repeats its rows rightly.
ShooterOptions ShooterOptionsOf(const SequencerOptions& options) {
  ShooterOptions shooter = options.shooter;
  if (options.witness.read_noise_dn <= 0.0) shooter.max_repeated_rows = 1.0;
  return shooter;
}

}  // namespace

CaptureRun::CaptureRun(const CapturePlan& plan, RigDevices devices, const SequencerOptions& options, Logger& logger,
                       const std::function<void()>& on_step, FrameSink& sink)
    : plan_(plan),
      devices_(devices),
      options_(options),
      logger_(logger),
      on_step_(on_step),
      sink_(sink),
      shooter_(std::move(devices), ShooterOptionsOf(options), plan.options.sync_mode, [this] { return CheckSafe(); }),
      witness_(plan, options.witness) {
  report_.planned = static_cast<int>(plan.steps.size());
}

Status CaptureRun::Run() {
  SLX_RETURN_IF_ERROR(LoadMemories());
  SLX_RETURN_IF_ERROR(RunPreroll());
  for (int p = 0; p < static_cast<int>(devices_.projectors.size()); ++p) SLX_RETURN_IF_ERROR(RunProjector(p));
  return Status::Ok();
}

std::vector<int> CaptureRun::StepsOf(int projector) const {
  std::vector<int> steps;
  for (const PlanStep& step : plan_.steps)
    if (step.projector == projector) steps.push_back(step.index);
  return steps;
}

std::string CaptureRun::Describe(int step) const {
  const PlanStep& s = plan_.steps[step];
  return "step " + std::to_string(step) + " (projector " + std::to_string(s.projector) + ", " + ToString(s.phase) +
         ", " + s.pattern.ToString() + ")";
}

Status CaptureRun::LoadMemories() {
  const std::vector<int> preroll = StepsOf(-1);
  for (int p = 0; p < static_cast<int>(devices_.projectors.size()); ++p) {
    std::vector<Pattern> sequence;
    for (int step : preroll) sequence.push_back(plan_.steps[step].pattern);
    for (int step : StepsOf(p)) sequence.push_back(plan_.steps[step].pattern);
    SLX_RETURN_IF_ERROR(devices_.projectors[p]->Load(sequence).WithContext("loading projector " + std::to_string(p)));
  }
  return Status::Ok();
}

Status CaptureRun::SetLight(int projector, bool on) {
  if (!on) return devices_.light.Off(projector);
  double longest_ms = 0.0;
  for (const PlanStep& step : plan_.steps) longest_ms = std::max(longest_ms, step.exposure_ms);
  return devices_.light.On(projector, {options_.LongestStep(longest_ms), options_.max_on_time});
}

Status CaptureRun::SetLights(bool on) {
  for (int p = 0; p < static_cast<int>(devices_.projectors.size()); ++p) SLX_RETURN_IF_ERROR(SetLight(p, on));
  return Status::Ok();
}

Status CaptureRun::CheckSafe() { return WhyDark(devices_.light.Check()); }

Status CaptureRun::BeginStep() { return WhyDark(devices_.light.Renew()); }

Status CaptureRun::WhyDark(const Status& light) const {
  if (light.ok() || devices_.light.stop().reason() == StopReason::kOperator) return light;
  return Status::Failed(light.message() + "; all lights are off");
}

Status CaptureRun::RunPreroll() {
  const std::vector<int> steps = StepsOf(-1);
  if (steps.empty()) return Status::Ok();
  SLX_RETURN_IF_ERROR(SetLights(true));
  // A covered lens sees no markers; only a dark session may be dark.
  const bool readable = plan_.options.kind != SessionKind::kDark;
  std::vector<Shot> shots;
  PrerollReading reading{!readable, ""};
  for (int retry = 0;; ++retry) {
    const int64_t triggers_before = shooter_.camera_triggers();
    SLX_ASSIGN_OR_RETURN(const bool whole, ShootPreroll(steps, retry, shots));
    if (whole && readable) reading = ReadMarkers(shots);
    if (whole && reading.decoded) break;
    if (whole) {
      report_.Note(ShotFault::kWrongLevel);
      for (int step : steps) retake_cause_[step] = ShotFault::kWrongLevel;
      logger_.Warning(reading.reason);
    }
    if (retry == options_.max_retries && whole) break;  // the frames go out, to show what was seen
    // The markers only mean something in a row, so the whole pre-roll is shot again.
    spoilt_triggers_ += shooter_.camera_triggers() - triggers_before;
    if (retry == options_.max_retries)
      return Status::Failed("pre-roll: no unbroken marker code in " + std::to_string(retry + 1) + " attempts (" +
                            report_.FaultSummary() + ")");
    ++report_.retried;
    SLX_RETURN_IF_ERROR(SetLights(false));
    SLX_RETURN_IF_ERROR(LoadMemories());
    SLX_RETURN_IF_ERROR(shooter_.Drain().status());
    SLX_RETURN_IF_ERROR(SetLights(true));
  }
  SLX_RETURN_IF_ERROR(SetLights(false));
  for (Shot& shot : shots) {
    if (readable) shot.record.level_check = reading.decoded ? LevelCheck::kPassed : LevelCheck::kFailed;
    if (readable && reading.decoded) witness_.AddPreroll(plan_.steps[shot.record.step], shot.pixels);
    SLX_RETURN_IF_ERROR(Emit(std::move(shot)));
  }
  return reading.decoded ? Status::Ok() : Status::Failed(reading.reason);
}

PrerollReading CaptureRun::ReadMarkers(const std::vector<Shot>& shots) const {
  std::vector<double> levels;
  std::vector<bool> code;
  for (const Shot& shot : shots) {
    levels.push_back(shot.record.mean_dn);
    code.push_back(shot.record.pattern.kind == PatternKind::kWhite);
  }
  PrerollReading reading = ReadPreroll(levels, code, options_.min_preroll_contrast_dn);
  if (!reading.decoded) return reading;
  std::vector<const Image<uint16_t>*> frames;
  for (const Shot& shot : shots) frames.push_back(&shot.pixels);
  const WitnessOptions& witness = options_.witness;
  const OddMarker odd = FindOddMarker(frames, code, [&](double dn) { return witness.VarianceDn(dn); });
  if (odd.share > witness.max_off_fraction)
    return {false, "pre-roll: marker " + std::to_string(odd.marker) +
                       " differs from the others of its kind; the visitor moved, a lamp changed or the frame is torn"};
  return reading;
}

Result<bool> CaptureRun::ShootPreroll(const std::vector<int>& steps, int retry, std::vector<Shot>& shots) {
  shots.clear();
  for (int step : steps) {
    SLX_RETURN_IF_ERROR(BeginStep());
    SLX_ASSIGN_OR_RETURN(Shot shot, shooter_.Take(plan_.steps[step], retry));
    ShotFault fault = shot.fault;
    if (fault == ShotFault::kNone) {
      SLX_ASSIGN_OR_RETURN(fault, shooter_.Drain());
    }
    if (fault != ShotFault::kNone) {
      logger_.Warning(Describe(step) + ": " + ToString(fault) + "; the pre-roll is shot again");
      report_.Note(fault);
      for (int spoilt : steps) retake_cause_[spoilt] = fault;
      return false;
    }
    if (const auto cause = retake_cause_.find(step); cause != retake_cause_.end())
      shot.record.retake_cause = ToString(cause->second);
    shots.push_back(std::move(shot));
  }
  return true;
}

Status CaptureRun::RunProjector(int projector) {
  const std::vector<int> block = StepsOf(projector);
  if (block.empty()) return Status::Ok();
  witness_.StartProjector(projector);
  held_.clear();
  memory_cut_ = false;
  SLX_RETURN_IF_ERROR(SetLight(projector, true));
  // The sweep is judged by the codes, so these are settled first.
  const auto sweep = std::find_if(block.begin(), block.end(), [&](int step) {
    const CapturePhase phase = plan_.steps[step].phase;
    return phase == CapturePhase::kSweep || phase == CapturePhase::kMotion;
  });
  SLX_RETURN_IF_ERROR(ShootBlock({block.begin(), sweep}));
  if (memory_cut_ && sweep != block.end()) SLX_RETURN_IF_ERROR(Reload(block, sweep - block.begin()));
  SLX_RETURN_IF_ERROR(ShootBlock({sweep, block.end()}));
  SLX_RETURN_IF_ERROR(SetLight(projector, false));
  for (std::string& reason : witness_.CheckProjector()) report_.reasons.push_back(std::move(reason));
  return Status::Ok();
}

Status CaptureRun::ShootBlock(std::vector<int> block) {
  while (!block.empty()) {
    SLX_RETURN_IF_ERROR(ShootSteps(block));
    block = RetakeDoubtful(witness_.TakeDoubtful());
    if (!block.empty()) SLX_RETURN_IF_ERROR(Reload(block, 0));
  }
  return Status::Ok();
}

std::vector<int> CaptureRun::RetakeDoubtful(const std::vector<int>& doubtful) {
  std::vector<int> again;
  for (int step : doubtful) {
    const std::vector<int> group = PatternWitness::GroupOf(plan_, step);
    const int worst =
        *std::max_element(group.begin(), group.end(), [&](int a, int b) { return retries_[a] < retries_[b]; });
    if (!RetriesLeft(worst)) {
      wrong_level_.insert(step);
      proven_.erase(step);
      continue;
    }
    again.push_back(step);
  }
  for (int step : again) {
    ++retries_[step];
    retake_cause_[step] = ShotFault::kWrongLevel;
    proven_.erase(step);
  }
  if (again.empty()) return again;
  report_.Note(ShotFault::kWrongLevel);
  report_.retried += static_cast<int>(again.size());
  logger_.Warning(Describe(again.front()) + " and " + std::to_string(again.size() - 1) +
                  " more: the projector was out of step soon after; shot again");
  return again;
}

Status CaptureRun::ShootSteps(const std::vector<int>& block) {
  size_t position = 0;
  while (true) {
    SLX_RETURN_IF_ERROR(DrainBefore(block, position));
    if (position == block.size()) return Status::Ok();
    SLX_RETURN_IF_ERROR(BeginStep());
    SLX_RETURN_IF_ERROR(ShootNext(block, position));
  }
}

Status CaptureRun::DrainBefore(const std::vector<int>& block, size_t& position) {
  SLX_ASSIGN_OR_RETURN(const ShotFault fault, shooter_.Drain());
  if (fault == ShotFault::kNone) return Status::Ok();
  if (position == 0) {  // left over from before this projector's first shot: nothing of it is spoilt
    report_.Note(fault);
    return fault == ShotFault::kExtraSync ? Reload(block, 0) : Status::Ok();
  }
  --position;
  if (!held_.empty() && held_.back().record.step == block[position]) {
    held_.pop_back();
    ++spoilt_triggers_;
  }
  proven_.erase(block[position]);
  return ShootAgain(block, position, fault);
}

Status CaptureRun::ShootNext(const std::vector<int>& block, size_t& position) {
  const PlanStep& step = plan_.steps[block[position]];
  const int64_t triggers_before = shooter_.camera_triggers();
  SLX_ASSIGN_OR_RETURN(Shot shot, shooter_.Take(step, retries_[step.index]));
  if (const auto cause = retake_cause_.find(step.index); cause != retake_cause_.end())
    shot.record.retake_cause = ToString(cause->second);
  if (shot.fault != ShotFault::kNone) {
    spoilt_triggers_ += shooter_.camera_triggers() - triggers_before;
    if (const Result<ShotFault> drained = shooter_.Drain(); !drained.ok()) return drained.status();
    return ShootAgain(block, position, shot.fault);
  }
  silent_steps_ = 0;
  witness_.Add(step, shot.pixels, shot.record.mean_dn);
  held_.push_back(std::move(shot));
  if (PatternWitness::GroupOf(plan_, step.index).back() == step.index) return JudgeGroup(block, position);
  ++position;
  Advance(step.index);
  return Status::Ok();
}

Status CaptureRun::JudgeGroup(const std::vector<int>& block, size_t& position) {
  const PlanStep& last = plan_.steps[block[position]];
  const std::vector<int> group = PatternWitness::GroupOf(plan_, last.index);
  const LevelCheck verdict = witness_.Check(last);
  for (Shot& shot : held_) {
    shot.record.level_check = verdict;
    SLX_RETURN_IF_ERROR(Emit(std::move(shot)));
  }
  held_.clear();
  Advance(last.index);
  ++position;
  if (verdict != LevelCheck::kFailed) {
    for (int step : group) wrong_level_.erase(step);
    return Status::Ok();
  }
  report_.Note(ShotFault::kWrongLevel);
  wrong_level_.insert(group.begin(), group.end());
  // Given up; but the memory may stand elsewhere than planned, so what follows starts afresh.
  if (!RetriesLeft(last.index)) return Reload(block, position);
  if (retries_[last.index] > 0 && last.phase != CapturePhase::kReference && witness_.ReferenceStandsAlone())
    if (const std::optional<size_t> reference = ReferenceIn(block)) {
      position = *reference;
      return ShootReferenceAgain(block, position);
    }
  logger_.Warning(Describe(last.index) + ": the frame does not show the pattern; shot again");
  for (int step : group) {
    ++retries_[step];
    retake_cause_[step] = ShotFault::kWrongLevel;
  }
  report_.retried += static_cast<int>(group.size());
  position -= group.size();
  return Reload(block, position);
}

std::optional<size_t> CaptureRun::ReferenceIn(const std::vector<int>& block) const {
  for (size_t i = 0; i < block.size(); ++i)
    if (plan_.steps[block[i]].phase == CapturePhase::kReference && RetriesLeft(block[i])) return i;
  return std::nullopt;
}

Status CaptureRun::ShootReferenceAgain(const std::vector<int>& block, size_t position) {
  logger_.Warning(Describe(block[position]) + ": what follows contradicts the reference; it is shot again");
  for (int step : PatternWitness::GroupOf(plan_, block[position])) {
    ++retries_[step];
    ++report_.retried;
    retake_cause_[step] = ShotFault::kWrongLevel;
    proven_.erase(step);
  }
  return Reload(block, position);
}

Status CaptureRun::ShootAgain(const std::vector<int>& block, size_t& position, ShotFault fault) {
  const int step = block[position];
  report_.Note(fault);
  if (RetriesLeft(step)) {
    ++retries_[step];
    retake_cause_[step] = fault;
    ++report_.retried;
    logger_.Warning(Describe(step) + ": " + ToString(fault) + "; shot again");
    return Reload(block, position);
  }
  logger_.Error(Describe(step) + ": " + ToString(fault) + " after " + std::to_string(options_.max_retries) +
                " retries; given up");
  if (++silent_steps_ >= options_.max_silent_steps)
    return Status::Failed(std::to_string(silent_steps_) + " steps in a row without a usable frame (" +
                          report_.FaultSummary() + "); check the camera's and projectors' cables and power");
  // A group that lacks a member cannot be judged: what was held goes out as not checked.
  ++position;
  Advance(step);
  if (PatternWitness::GroupOf(plan_, step).back() == step) {
    for (Shot& shot : held_) SLX_RETURN_IF_ERROR(Emit(std::move(shot)));
    held_.clear();
  }
  return Reload(block, position);
}

Status CaptureRun::Reload(const std::vector<int>& block, size_t position) {
  memory_cut_ = true;
  if (position == block.size()) return Status::Ok();
  witness_.MemoryLoaded();
  std::vector<Pattern> sequence;
  for (size_t i = position; i < block.size(); ++i) sequence.push_back(plan_.steps[block[i]].pattern);
  const int projector = plan_.steps[block[position]].projector;
  // A memory that is stepped to its place shows everything on the way: to nobody.
  SLX_RETURN_IF_ERROR(SetLight(projector, false));
  SLX_RETURN_IF_ERROR(
      devices_.projectors[projector]->Load(sequence).WithContext("reloading projector " + std::to_string(projector)));
  return SetLight(projector, true);
}

void CaptureRun::Advance(int step) {
  // A step shot again was counted before.
  if (step <= furthest_step_) return;
  furthest_step_ = step;
  if (on_step_) on_step_();
}

Status CaptureRun::Emit(Shot shot) {
  if (shot.record.level_check != LevelCheck::kFailed) proven_[shot.record.step] = shot.record;
  if (shot.record.projector < 0) Advance(shot.record.step);
  ++report_.frames;
  return sink_.Put(std::move(shot.record), std::move(shot.pixels)).WithContext("recording");
}

}  // namespace stratalux::rig
