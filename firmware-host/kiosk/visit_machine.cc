// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/visit_machine.h"

#include <utility>

#include "firmware-host/kiosk/findings_gate.h"

namespace stratalux::rig {
namespace {

using Light = VisitState::Light;
using Work = VisitState::Work;
using Sessions = VisitState::Sessions;

// Visits in a row that the rig may spoil before it is out of order.
constexpr int kMostFaults = 2;

// One step: each On is an event, and says what it does in which phase; in all others it does nothing.
class Stepper {
 public:
  Stepper(const VisitRules& rules, const VisitState& state) : rules_(rules), s_(state) {}

  VisitStep Run(const VisitEvent& event) {
    std::visit([this](const auto& happened) { On(happened); }, event);
    return {s_, std::move(actions_)};
  }

 private:
  // The visitor.
  void On(const event::Start& /*event*/);
  void On(const event::NotSensitive& /*event*/);
  void On(const event::Sensitive& /*event*/);
  void On(const event::Agree& agreed);
  void On(const event::Refuse& /*event*/);
  void On(const event::Leave& /*event*/);
  void On(const event::Tick& tick);
  // The shell's answers.
  void On(const event::Face& face);
  void On(const event::NoFace& /*event*/);
  void On(const event::Progress& progress);
  void On(const event::Captured& captured);
  void On(const event::Failed& failed);
  void On(const event::Discarded& /*event*/);
  void On(const event::DiscardFailed& /*event*/);
  void On(const event::Checked& checked);
  void On(const event::Recovered& recovered);
  // The rig and what is around it.
  void On(const event::InterlockChanged& changed);
  void On(const event::DeviceChanged& changed);
  void On(const event::Space& space) { Close(Closure::kSpace, space.bytes < rules_.space_bytes); }
  void On(const event::Calibration& calibration);
  void On(const event::Hours& hours) { Close(Closure::kHours, !hours.open); }
  void On(const event::Operator& ordered);
  void On(const event::PageLost& /*event*/) {}
  void On(const event::PageBack& /*event*/) { Show(); }
  void On(const event::ClockJumped& /*event*/) { Do(action::TellOperator{Word::kClockJumped}); }
  void On(const event::Leftover& /*event*/) { Do(action::TellOperator{Word::kLeftover}); }
  void On(const event::Shutdown& /*event*/);

  [[nodiscard]] bool In(Phase phase) const { return s_.phase == phase; }
  [[nodiscard]] bool AtRest() const { return In(Phase::kIdle) || In(Phase::kClosed); }
  [[nodiscard]] bool BeforeCapture() const {
    return In(Phase::kQuestion) || In(Phase::kConsent) || In(Phase::kPosition) || In(Phase::kCountdown);
  }
  [[nodiscard]] bool InVisit() const { return BeforeCapture() || In(Phase::kCapture) || In(Phase::kGate); }

  void Do(VisitAction action) { actions_.push_back(action); }
  void Show();
  void ShowOf(int number, int of, const FaceBox& box);
  void Enter(Phase phase, Deadline deadline);
  void Darken();
  // The visit's number stays.
  void ClearVisit();

  void BeginCountdown();
  void BeginCapture();
  void Conclude(const Judgement& judgement);
  void Thank(Word word);
  void Discard(Word reason);
  // What becomes of a visit that comes to no ticket: dark, its capture stopped, its sessions discarded; one without
  // any is counted.
  void Abandon(Word why);
  // The visit is over: abandoned unless it was kept; then to rest.
  void End(Word why);
  // The same, by the rig's doing.
  void EndSpoilt();
  // At the gate: what is worth keeping is kept.
  void GiveUp(Word why);
  // To where nobody is: kForgetting until all is discarded, then kIdle or kClosed.
  void Rest();
  void GoSafe(Word why);
  void Close(Closure reason, bool closed);
  // The visitor's capture is over, and nobody waits for it any more.
  void DiscardUnwanted();
  void BeginSelfcheck();
  void Open();

  const VisitRules& rules_;
  VisitState s_;
  std::vector<VisitAction> actions_;
};

void Stepper::Show() {
  if (In(Phase::kCountdown)) return ShowOf(s_.count, rules_.countdown, {});
  if (In(Phase::kGate)) return ShowOf(s_.attempt, rules_.attempts, {});
  ShowOf(0, 0, {});
}

void Stepper::ShowOf(int number, int of, const FaceBox& box) {
  const bool closed = In(Phase::kClosed);
  const Word word = In(Phase::kSafe) ? s_.safe_for : s_.word;
  const bool usable = In(Phase::kGate) && s_.usable;
  Do(action::Show{s_.phase, word, closed ? s_.closed_for : EnumSet<Closure>(), number, of, box, usable});
}

void Stepper::Enter(Phase phase, Deadline deadline) {
  s_.phase = phase;
  if (s_.armed != Deadline::kNone || deadline != Deadline::kNone) Do(action::Arm{deadline});
  s_.armed = deadline;
}

void Stepper::Darken() {
  if (s_.light != Light::kOff) Do(action::LightOff{});
  s_.light = Light::kOff;
}

void Stepper::ClearVisit() {
  const VisitState empty;
  s_.sessions = empty.sessions;
  s_.consented = empty.consented;
  s_.consent = empty.consent;
  s_.steady = empty.steady;
  s_.count = empty.count;
  s_.attempt = empty.attempt;
  s_.unproven = empty.unproven;
  s_.usable = empty.usable;
  s_.exposure_us = empty.exposure_us;
}

void Stepper::On(const event::Start& /*event*/) {
  if (In(Phase::kIdle)) {
    ++s_.visit;
    s_.word = Word::kNone;
    Enter(Phase::kQuestion, Deadline::kQuestion);
    return Show();
  }
  if (In(Phase::kQuestion) && rules_.paper_consent) return On(event::NotSensitive{});
  if (In(Phase::kConsent) && rules_.paper_consent) return On(event::Agree{rules_.paper});
  if (In(Phase::kGate)) return BeginCountdown();
  if (In(Phase::kThanks)) End(Word::kNone);
}

void Stepper::On(const event::NotSensitive& /*event*/) {
  if (!In(Phase::kQuestion)) return;
  Enter(Phase::kConsent, Deadline::kConsent);
  Show();
}

void Stepper::On(const event::Sensitive& /*event*/) {
  if (In(Phase::kQuestion)) End(Word::kSensitive);
}

// Without the scope fit there is nothing to capture for.
void Stepper::On(const event::Agree& agreed) {
  if (!In(Phase::kConsent)) return;
  if (!agreed.choice.fit) return End(Word::kRefused);
  s_.consented = true;
  s_.consent = agreed.choice;
  s_.word = Word::kNoFace;
  Enter(Phase::kPosition, Deadline::kPosition);
  s_.light = Light::kPreview;
  Do(action::Preview{});
  Show();
}

// Once something was captured: agrees no more, whatever was kept.
void Stepper::On(const event::Refuse& /*event*/) {
  if (In(Phase::kThanks)) s_.sessions = Sessions::kBegun;
  if (InVisit() || In(Phase::kThanks)) End(Word::kRefused);
}

void Stepper::On(const event::Leave& /*event*/) {
  if (In(Phase::kGate)) return GiveUp(Word::kLeft);
  if (InVisit() || In(Phase::kThanks)) End(Word::kLeft);
}

void Stepper::On(const event::Tick& tick) {
  if (tick.deadline == Deadline::kNone || tick.deadline != s_.armed) return;
  switch (s_.phase) {
    case Phase::kCountdown:
      if (--s_.count == 0) return BeginCapture();
      Enter(Phase::kCountdown, Deadline::kCountdown);
      return Show();
    case Phase::kGate:
      return GiveUp(Word::kTimeOut);
    case Phase::kCapture:
    case Phase::kForgetting:
    case Phase::kSelfcheck:
      return GoSafe(Word::kStuck);
    case Phase::kClosed:
      return Rest();
    default:
      return End(In(Phase::kThanks) ? Word::kNone : Word::kTimeOut);
  }
}

void Stepper::On(const event::Face& face) {
  if (!In(Phase::kPosition)) return;
  s_.word = JudgeFace(face, rules_);
  s_.steady = s_.word == Word::kHold ? s_.steady + 1 : 0;
  s_.exposure_us = face.exposure_us;
  if (s_.steady >= rules_.steady_looks) return BeginCountdown();
  ShowOf(0, 0, face.box);
}

void Stepper::On(const event::NoFace& /*event*/) {
  if (!In(Phase::kPosition)) return;
  s_.steady = 0;
  s_.word = Word::kNoFace;
  Show();
}

void Stepper::BeginCountdown() {
  Darken();
  s_.count = rules_.countdown;
  Enter(Phase::kCountdown, Deadline::kCountdown);
  Show();
}

void Stepper::BeginCapture() {
  ++s_.attempt;
  s_.word = Word::kNone;
  s_.sessions = Sessions::kBegun;
  s_.work = Work::kCapture;
  s_.light = Light::kCapture;
  Enter(Phase::kCapture, Deadline::kCapture);
  Show();
  Do(action::StartCapture{s_.visit, s_.attempt, s_.exposure_us, s_.consent});
}

void Stepper::On(const event::Progress& progress) {
  if (In(Phase::kCapture)) ShowOf(progress.done, progress.of, {});
}

void Stepper::On(const event::Captured& captured) {
  if (s_.work != Work::kCapture) return;
  s_.work = Work::kNone;
  if (!In(Phase::kCapture)) return DiscardUnwanted();
  s_.light = Light::kOff;  // as the capture leaves it
  const CaptureFacts& facts = captured.facts;
  const Judgement judgement = JudgeCapture(facts, {s_.attempt, s_.unproven, s_.exposure_us}, rules_);
  const bool failed = facts.worth == CaptureFacts::Worth::kFailed;
  s_.unproven += failed || facts.unproven ? 1 : 0;
  s_.usable |= !failed;
  if (!failed) s_.faults = 0;
  Conclude(judgement);
}

void Stepper::Conclude(const Judgement& judgement) {
  s_.word = judgement.word;
  switch (judgement.verdict) {
    case Verdict::kSafe:
      return GoSafe(judgement.word);
    case Verdict::kRetakeShorter:
      s_.exposure_us /= 2;
      return BeginCountdown();
    case Verdict::kOffer:
      Enter(Phase::kGate, Deadline::kGate);
      return Show();
    case Verdict::kAccept:
      return s_.usable ? Thank(judgement.word) : EndSpoilt();
  }
}

void Stepper::Thank(Word word) {
  s_.word = word;
  s_.sessions = Sessions::kKept;
  if (word == Word::kLamp || word == Word::kProof) Do(action::TellOperator{word});
  Enter(Phase::kThanks, Deadline::kThanks);
  Do(action::PrintTicket{s_.visit});
  Show();
}

void Stepper::On(const event::Failed& failed) {
  const bool capture = s_.work == Work::kCapture;
  if (capture) s_.work = Work::kNone;
  if (In(Phase::kCapture) || In(Phase::kPosition)) return failed.light_taken ? GoSafe(Word::kLight) : EndSpoilt();
  if (capture) DiscardUnwanted();
  // Whoever waits for it: nothing but an operator's reset gives the light back.
  if (failed.light_taken && !In(Phase::kSafe)) GoSafe(Word::kLight);
}

void Stepper::DiscardUnwanted() {
  if (s_.sessions == Sessions::kBegun) Discard(s_.word);
}

void Stepper::Discard(Word reason) {
  s_.work = Work::kDiscard;
  Do(action::Discard{s_.visit, reason});
}

void Stepper::On(const event::Discarded& /*event*/) {
  if (s_.work != Work::kDiscard) return;
  s_.work = Work::kNone;
  s_.closed_for.Remove(Closure::kUnforgotten);
  ClearVisit();
  if (!In(Phase::kSafe)) Rest();
}

void Stepper::On(const event::DiscardFailed& /*event*/) {
  if (s_.work != Work::kDiscard) return;
  s_.work = Work::kNone;
  s_.closed_for.Add(Closure::kUnforgotten);
  Do(action::TellOperator{Word::kUnforgotten});
  if (!In(Phase::kSafe)) Rest();
}

void Stepper::Abandon(Word why) {
  Darken();
  s_.word = why;
  if (s_.work == Work::kCapture) {
    Do(action::StopCapture{why});
  } else if (s_.sessions == Sessions::kBegun && s_.work == Work::kNone) {
    Discard(why);
  }
  if (BeforeCapture() && s_.sessions == Sessions::kNone) Do(action::Count{why});
  if (s_.sessions != Sessions::kBegun) ClearVisit();
}

void Stepper::End(Word why) {
  Abandon(why);
  Rest();
}

void Stepper::EndSpoilt() {
  Darken();
  Do(action::TellOperator{Word::kFault});
  if (++s_.faults >= kMostFaults) s_.closed_for.Add(Closure::kFault);
  End(Word::kFault);
}

void Stepper::GiveUp(Word why) {
  if (s_.usable) return Thank(why == Word::kDevice ? why : Word::kGivenUp);
  End(why);
}

void Stepper::Rest() {
  // What is still to be forgotten then goes on behind a screen that says closed.
  const bool behind = s_.closed_for.Has(Closure::kShutdown) || s_.closed_for.Has(Closure::kUnforgotten);
  if (s_.sessions == Sessions::kBegun && !behind) {
    Enter(Phase::kForgetting, Deadline::kForgetting);
    return Show();
  }
  const bool reopen = s_.closed_for.Has(Closure::kDevice) && s_.lost.empty() && s_.work == Work::kNone;
  if (reopen && !s_.closed_for.Has(Closure::kShutdown)) {
    s_.work = Work::kRecover;
    Do(action::Recover{});
  }
  Enter(s_.closed_for.empty() ? Phase::kIdle : Phase::kClosed, Deadline::kNone);
  Show();
}

void Stepper::GoSafe(Word why) {
  if (InVisit() || In(Phase::kThanks) || In(Phase::kForgetting)) Abandon(why);
  Darken();
  // It was before what happens now: another one is needed.
  if (s_.work == Work::kReset) s_.work = Work::kRecover;
  // What hangs stays what is said, whatever comes on top of it.
  const bool hangs = In(Phase::kSafe) && s_.safe_for == Word::kStuck && s_.work != Work::kNone;
  if (!hangs || s_.work == Work::kRecover) s_.safe_for = why;
  Enter(Phase::kSafe, Deadline::kNone);
  Do(action::TellOperator{why});
  Show();
}

void Stepper::On(const event::InterlockChanged& changed) {
  s_.interlock.Set(changed.which, changed.active);
  if (!changed.active) {
    if (In(Phase::kSafe)) Show();
    return;
  }
  Do(action::LightOff{});
  s_.light = Light::kOff;
  GoSafe(changed.which == Interlock::kDoor ? Word::kDoor : Word::kEmergencyStop);
}

void Stepper::On(const event::DeviceChanged& changed) {
  if (changed.there) {
    const bool was_lost = s_.lost.Has(changed.which);
    s_.lost.Remove(changed.which);
    if (was_lost && In(Phase::kClosed)) Rest();
    return;
  }
  s_.lost.Add(changed.which);
  Do(action::LightOff{});
  s_.light = Light::kOff;
  s_.closed_for.Add(Closure::kDevice);
  // Without the lines nobody can tell whether door and E-STOP are open.
  if (changed.which == Device::kLines) return GoSafe(Word::kDevice);
  Do(action::TellOperator{Word::kDevice});
  if (In(Phase::kGate)) return GiveUp(Word::kDevice);
  if (InVisit() || In(Phase::kSelfcheck)) return End(Word::kDevice);
  if (AtRest()) Rest();
}

void Stepper::On(const event::Calibration& calibration) {
  const bool old = rules_.calibration_days > 0 && calibration.age_days > rules_.calibration_days;
  Close(Closure::kCalibration, !calibration.there || old);
}

// A visit that has begun is not closed on.
void Stepper::Close(Closure reason, bool closed) {
  if (s_.closed_for.Has(reason) == closed) return;
  s_.closed_for.Set(reason, closed);
  if (AtRest()) Rest();
}

void Stepper::On(const event::Operator& ordered) {
  switch (ordered.command) {
    case OperatorCommand::kClean:
      return Close(Closure::kCleaning, true);
    case OperatorCommand::kOutOfOrder:
      return Close(Closure::kOutOfOrder, true);
    case OperatorCommand::kOpen:
      return Open();
    case OperatorCommand::kSelfcheck:
      return BeginSelfcheck();
    case OperatorCommand::kReset:
      if (!In(Phase::kSafe) || s_.work == Work::kReset) return;
      if (!s_.interlock.empty() || s_.work != Work::kNone) return Do(action::TellOperator{s_.safe_for});
      s_.work = Work::kReset;
      return Do(action::Recover{});
  }
}

void Stepper::Open() {
  for (const Closure reason : {Closure::kCleaning, Closure::kOutOfOrder, Closure::kFault}) s_.closed_for.Remove(reason);
  s_.faults = 0;
  if (!In(Phase::kClosed)) return;
  if (s_.sessions == Sessions::kBegun && s_.work == Work::kNone) Discard(s_.word);
  Rest();
}

void Stepper::On(const event::Recovered& recovered) {
  if (s_.work != Work::kRecover && s_.work != Work::kReset) return;
  const bool leaves = !In(Phase::kSafe) || s_.work == Work::kReset;
  s_.work = Work::kNone;
  const bool good = recovered.good && s_.interlock.empty() && s_.lost.empty();
  if (good) s_.closed_for.Remove(Closure::kDevice);
  if (!good) Do(action::TellOperator{In(Phase::kSafe) ? s_.safe_for : Word::kDevice});
  // It is there and does not open: rights that come late, a driver that settles. Nothing else asks again.
  if (!good && In(Phase::kClosed) && s_.lost.empty()) Enter(Phase::kClosed, Deadline::kReopen);
  if (!good || !leaves) return Show();
  s_.safe_for = Word::kNone;
  Rest();
}

void Stepper::BeginSelfcheck() {
  const bool may = AtRest() && s_.work == Work::kNone && !s_.closed_for.Has(Closure::kDevice) &&
                   !s_.closed_for.Has(Closure::kShutdown) && s_.sessions == Sessions::kNone;
  if (!may) return;
  s_.word = Word::kNone;
  s_.light = Light::kCheck;
  s_.work = Work::kCheck;
  Enter(Phase::kSelfcheck, Deadline::kSelfcheck);
  Show();
  Do(action::CheckRig{});
}

void Stepper::On(const event::Checked& checked) {
  if (s_.work != Work::kCheck) return;
  s_.work = Work::kNone;
  s_.light = Light::kOff;
  if (In(Phase::kSafe)) return;
  if (checked.passed) s_.faults = 0;
  s_.closed_for.Set(Closure::kFault, !checked.passed);
  if (!checked.passed) Do(action::TellOperator{Word::kSelfcheckFailed});
  if (checked.drifted) Do(action::TellOperator{Word::kDrift});
  s_.word = checked.passed ? Word::kNone : Word::kSelfcheckFailed;
  checked.light_taken ? GoSafe(Word::kLight) : Rest();
}

void Stepper::On(const event::Shutdown& /*event*/) {
  Do(action::LightOff{});
  s_.light = Light::kOff;
  s_.closed_for.Add(Closure::kShutdown);
  if (In(Phase::kSafe)) return;
  End(Word::kShutdown);
}

}  // namespace

VisitStep Step(const VisitRules& rules, const VisitState& state, const VisitEvent& event) {
  return Stepper(rules, state).Run(event);
}

}  // namespace stratalux::rig
