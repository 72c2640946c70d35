// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/capture_run.h"

#include <algorithm>
#include <utility>

#include "firmware-host/projector/memory_layout.h"

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
                       CaptureObserver& observer, FrameSink& sink)
    : plan_(plan),
      devices_(devices),
      options_(options),
      logger_(logger),
      observer_(observer),
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
  for (int p = 0; p < static_cast<int>(devices_.projectors.size()); ++p)
    SLX_RETURN_IF_ERROR(
        devices_.projectors[p]->Load(SequenceOf(plan_, p)).WithContext("loading projector " + std::to_string(p)));
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

Status CaptureRun::RenewLight() { return WhyDark(devices_.light.Renew()); }

Status CaptureRun::BeginShot(int step) {
  if (Status ended = observer_.BeforeShot(plan_.steps[step], retries_[step]); !ended.ok())
    return EndFor({FindingKind::kStopped, -1, step, 0.0, 0.0, ended.message()});
  return RenewLight();
}

Status CaptureRun::EndFor(Finding why) {
  ended_for_ = std::move(why);
  return Status::Failed(ToText({*ended_for_}).front());
}

void CaptureRun::NoteFault(int step, ShotFault fault) {
  report_.Note(fault);
  observer_.OnFault(plan_.steps[step], fault);
}

Status CaptureRun::Add(Finding finding) {
  const bool told = finding.step >= 0 && told_whites_.contains(finding.step);
  report_.findings.push_back(finding);
  return told ? Status::Ok() : Tell(finding);
}

Status CaptureRun::TellWhite(const PlanStep& white) {
  const std::optional<Finding> finding = witness_.CheckWhite(white);
  if (!finding || !told_whites_.insert(white.index).second) return Status::Ok();
  Status ended = Tell(*finding);
  // The projector's own check, which adds it, is never come to.
  if (!ended.ok()) report_.findings.push_back(*finding);
  return ended;
}

Status CaptureRun::Tell(const Finding& finding) {
  if (Status ended = observer_.OnFinding(finding); !ended.ok())
    return EndFor({FindingKind::kStopped, finding.projector, finding.step, 0.0, 0.0, ended.message()});
  return Status::Ok();
}

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
      NoteFault(steps.front(), ShotFault::kWrongLevel);
      for (int step : steps) retake_cause_[step] = ShotFault::kWrongLevel;
      logger_.Warning(reading.reason);
    }
    if (retry == options_.max_retries && whole) break;  // the frames go out, to show what was seen
    // The markers only mean something in a row, so the whole pre-roll is shot again.
    spoilt_triggers_ += shooter_.camera_triggers() - triggers_before;
    if (retry == options_.max_retries)
      return EndFor({FindingKind::kPreroll, -1, -1, retry + 1.0, 0.0,
                     "pre-roll: no unbroken marker code in " + std::to_string(retry + 1) + " attempts (" +
                         report_.FaultSummary() + ")"});
    ++report_.retried;
    SLX_RETURN_IF_ERROR(SetLights(false));
    for (Projector* projector : devices_.projectors) projector->Doubt();
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
  return reading.decoded ? Status::Ok() : EndFor({FindingKind::kPreroll, -1, -1, 0.0, 0.0, reading.reason});
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
    SLX_RETURN_IF_ERROR(BeginShot(step));
    SLX_ASSIGN_OR_RETURN(Shot shot, shooter_.Take(plan_.steps[step], retry));
    ShotFault fault = shot.fault;
    if (fault == ShotFault::kNone) {
      SLX_ASSIGN_OR_RETURN(fault, shooter_.Drain());
    }
    if (fault != ShotFault::kNone) {
      logger_.Warning(Describe(step) + ": " + ToString(fault) + "; the pre-roll is shot again");
      NoteFault(step, fault);
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
  const std::vector<int> steps = StepsOf(projector);
  if (steps.empty()) return Status::Ok();
  witness_.StartProjector(projector);
  held_.clear();
  last_kept_.reset();
  memory_at_ = steps.front();
  SLX_RETURN_IF_ERROR(SetLight(projector, true));
  // The sweep is judged by the codes, so these are settled first.
  const auto sweep = std::find_if(steps.begin(), steps.end(), [&](int step) {
    const CapturePhase phase = plan_.steps[step].phase;
    return phase == CapturePhase::kSweep || phase == CapturePhase::kMotion;
  });
  projector_begun_ = devices_.light.Now();
  bool begun_anew = false;
  while (true) {
    SLX_ASSIGN_OR_RETURN(BlockEnd end, ShootBlock({steps.begin(), sweep}));
    if (end == BlockEnd::kDone) {
      SLX_ASSIGN_OR_RETURN(end, ShootBlock({sweep, steps.end()}));
    }
    if (end == BlockEnd::kDone) break;
    begun_anew = true;
    SLX_RETURN_IF_ERROR(StartAgain(projector));
  }
  RefuteUnborneCodes(steps);
  SLX_RETURN_IF_ERROR(SetLight(projector, false));
  for (Finding& finding : witness_.CheckProjector()) SLX_RETURN_IF_ERROR(Add(std::move(finding)));
  return begun_anew ? CheckAllProvenAnew(projector) : Status::Ok();
}

Status CaptureRun::LoadFrom(int step) {
  const int projector = plan_.steps[step].projector;
  std::vector<Pattern> sequence;
  for (int later : StepsOf(projector))
    if (later >= step) sequence.push_back(plan_.steps[later].pattern);
  witness_.EndLoad();
  // A memory that is stepped to its place shows everything on the way: to nobody.
  SLX_RETURN_IF_ERROR(SetLight(projector, false));
  // Nothing but doubt leads here.
  Projector& doubted = *devices_.projectors[projector];
  doubted.Doubt();
  SLX_RETURN_IF_ERROR(doubted.Load(sequence).WithContext("reloading projector " + std::to_string(projector)));
  memory_at_ = step;
  return SetLight(projector, true);
}

int CaptureRun::StepAfter(int step) const {
  for (size_t later = step + 1; later < plan_.steps.size(); ++later)
    if (plan_.steps[later].projector == plan_.steps[step].projector) return static_cast<int>(later);
  return kNoStep;
}

void CaptureRun::Advance(int step) {
  // A step shot again was counted before.
  if (seen_.insert(step).second) observer_.OnStepDone(plan_.steps[step]);
}

Status CaptureRun::Emit(Shot shot) {
  if (shot.record.level_check != LevelCheck::kFailed) proven_[shot.record.step] = shot.record;
  if (shot.record.projector < 0) Advance(shot.record.step);
  ++report_.frames;
  observer_.OnFrame(shot.record, shot.pixels);
  return sink_.Put(std::move(shot.record), std::move(shot.pixels)).WithContext("recording");
}

}  // namespace stratalux::rig
