// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/kiosk/visit_cases.h"

#include <iterator>

namespace stratalux::rig {
namespace {

using Worth = CaptureFacts::Worth;

const event::Face kGoodFace = {{300, 100, 700, 900}, 800, 1000, 16000};
const event::Face kFarFace = {{450, 450, 550, 550}, 800, 1000, 16000};

CaptureFacts Degraded() {
  CaptureFacts facts;
  facts.worth = Worth::kDegraded;
  return facts;
}

std::map<std::string, CaptureFacts> Captures() {
  std::map<std::string, CaptureFacts> all;
  all["captured_good"] = {};
  all["captured_moved"] = Degraded();
  all["captured_moved"].moved = true;
  all["captured_saturated"] = {};
  all["captured_saturated"].saturated_permille = 50;
  all["captured_lamp"] = Degraded();
  all["captured_lamp"].lamp = true;
  all["captured_unproven"] = Degraded();
  all["captured_unproven"].unproven = true;
  all["captured_failed"].worth = Worth::kFailed;
  all["captured_taken"].worth = Worth::kFailed;
  all["captured_taken"].light_taken = true;
  return all;
}

VisitState At(Phase phase, Deadline armed = Deadline::kNone) {
  VisitState state;
  state.phase = phase;
  state.closed_for = {};
  state.armed = armed;
  return state;
}

VisitState InVisit(Phase phase, Deadline armed, Word word = Word::kNone) {
  VisitState state = At(phase, armed);
  state.visit = 1;
  state.word = word;
  if (phase == Phase::kQuestion || phase == Phase::kConsent) return state;
  state.consented = true;
  state.consent = {true, true, false, 1, 0};
  state.exposure_us = 16000;
  return state;
}

VisitState AfterCapture(Phase phase, Deadline armed, Word word) {
  VisitState state = InVisit(phase, armed, word);
  state.attempt = 1;
  state.sessions = VisitState::Sessions::kBegun;
  return state;
}

void AddSafe(std::map<std::string, VisitState>& all) {
  VisitState safe = At(Phase::kSafe);
  safe.safe_for = Word::kEmergencyStop;
  all["safe"] = all["pressed"] = all["recovering"] = safe;
  all["pressed"].interlock.Add(Interlock::kEmergencyStop);
  all["recovering"].work = VisitState::Work::kReset;
  VisitState ending = AfterCapture(Phase::kSafe, Deadline::kNone, Word::kEmergencyStop);
  ending.safe_for = Word::kEmergencyStop;
  ending.work = VisitState::Work::kCapture;
  all["ending"] = all["stuck"] = ending;
  all["stuck"].word = all["stuck"].safe_for = Word::kStuck;
}

void AddClosed(std::map<std::string, VisitState>& all) {
  all["closed"] = At(Phase::kClosed);
  all["closed"].closed_for = {Closure::kCleaning};
  VisitState away = At(Phase::kClosed);
  away.closed_for = {Closure::kDevice};
  away.word = Word::kDevice;
  all["unplugged"] = all["reopening"] = all["unopened"] = away;
  all["unopened"].armed = Deadline::kReopen;
  all["unplugged"].lost.Add(Device::kCamera);
  all["reopening"].work = VisitState::Work::kRecover;
  VisitState& unforgotten = all["unforgotten"] = AfterCapture(Phase::kClosed, Deadline::kNone, Word::kLeft);
  unforgotten.closed_for = {Closure::kUnforgotten};
}

}  // namespace

VisitRules TableRules() {
  VisitRules rules;
  rules.space_bytes = 1000;
  rules.calibration_days = 30;
  return rules;
}

std::map<std::string, VisitState> TableStates() {
  std::map<std::string, VisitState> all;
  all["idle"] = At(Phase::kIdle);
  AddClosed(all);
  AddSafe(all);
  all["question"] = InVisit(Phase::kQuestion, Deadline::kQuestion);
  all["consent"] = InVisit(Phase::kConsent, Deadline::kConsent);
  all["position"] = InVisit(Phase::kPosition, Deadline::kPosition, Word::kHold);
  all["position"].steady = 1;
  all["position"].light = VisitState::Light::kPreview;
  all["countdown"] = InVisit(Phase::kCountdown, Deadline::kCountdown, Word::kHold);
  all["countdown"].count = 1;
  all["capture"] = AfterCapture(Phase::kCapture, Deadline::kCapture, Word::kNone);
  all["capture"].light = VisitState::Light::kCapture;
  all["capture"].work = VisitState::Work::kCapture;
  all["gate"] = AfterCapture(Phase::kGate, Deadline::kGate, Word::kMoved);
  all["gate"].usable = true;
  all["gate_lost"] = AfterCapture(Phase::kGate, Deadline::kGate, Word::kProof);
  all["gate_lost"].unproven = 1;
  all["thanks"] = AfterCapture(Phase::kThanks, Deadline::kThanks, Word::kNone);
  all["thanks"].usable = true;
  all["thanks"].sessions = VisitState::Sessions::kKept;
  all["stopping"] = all["forgetting"] = AfterCapture(Phase::kForgetting, Deadline::kForgetting, Word::kLeft);
  all["stopping"].work = VisitState::Work::kCapture;
  all["forgetting"].work = VisitState::Work::kDiscard;
  all["checking"] = At(Phase::kSelfcheck, Deadline::kSelfcheck);
  all["checking"].light = VisitState::Light::kCheck;
  all["checking"].work = VisitState::Work::kCheck;
  return all;
}

std::map<std::string, VisitEvent> TableEvents(const VisitState& state) {
  const Deadline stale = state.armed == Deadline::kThanks ? Deadline::kGate : Deadline::kThanks;
  std::map<std::string, VisitEvent> all = {
      {"start", event::Start{}},
      {"not_sensitive", event::NotSensitive{}},
      {"sensitive", event::Sensitive{}},
      {"agree", event::Agree{{true, true, false, 1, 0}}},
      {"refuse", event::Refuse{}},
      {"leave", event::Leave{}},
      {"face_good", kGoodFace},
      {"face_far", kFarFace},
      {"no_face", event::NoFace{}},
      {"tick", event::Tick{state.armed}},
      {"stale_tick", event::Tick{stale}},
      {"progress", event::Progress{7, 100}},
      {"failed", event::Failed{false}},
      {"failed_taken", event::Failed{true}},
      {"discarded", event::Discarded{}},
      {"discard_failed", event::DiscardFailed{}},
      {"checked", event::Checked{true}},
      {"checked_bad", event::Checked{false}},
      {"checked_drift", event::Checked{true, true}},
      {"checked_taken", event::Checked{false, false, true}},
      {"recovered", event::Recovered{true}},
      {"recovered_not", event::Recovered{false}},
      {"estop", event::InterlockChanged{Interlock::kEmergencyStop, true}},
      {"estop_over", event::InterlockChanged{Interlock::kEmergencyStop, false}},
      {"door", event::InterlockChanged{Interlock::kDoor, true}},
      {"door_over", event::InterlockChanged{Interlock::kDoor, false}},
      {"camera_lost", event::DeviceChanged{Device::kCamera, false}},
      {"camera_back", event::DeviceChanged{Device::kCamera, true}},
      {"lines_lost", event::DeviceChanged{Device::kLines, false}},
      {"lines_back", event::DeviceChanged{Device::kLines, true}},
      {"space_low", event::Space{999}},
      {"space_good", event::Space{1000}},
      {"calibration_none", event::Calibration{false, 0}},
      {"calibration_old", event::Calibration{true, 31}},
      {"calibration_good", event::Calibration{true, 30}},
      {"hours_closed", event::Hours{false}},
      {"hours_open", event::Hours{true}},
      {"page_lost", event::PageLost{}},
      {"page_back", event::PageBack{}},
      {"clock_jumped", event::ClockJumped{}},
      {"leftover", event::Leftover{}},
      {"shutdown", event::Shutdown{}},
  };
  for (const auto& [name, facts] : Captures()) all[name] = event::Captured{facts};
  for (int i = 0; i < kOperatorCommands; ++i) {
    const auto command = static_cast<OperatorCommand>(i);
    all[ToString(command)] = event::Operator{command};
  }
  return all;
}

VisitEvent AnyEvent(Random& random, const VisitState& state) {
  const auto draw = [&](size_t count) { return static_cast<size_t>(random.Uniform() * static_cast<double>(count)); };
  static const std::vector<std::pair<Phase, std::vector<std::string>>> kLeadOn = {
      {Phase::kSafe, {"estop_over", "door_over", "reset", "recovered", "discarded", "captured_failed", "lines_back"}},
      {Phase::kClosed,
       {"space_good", "hours_open", "calibration_good", "open", "camera_back", "recovered", "discarded", "checked"}},
      {Phase::kIdle, {"start"}},
      {Phase::kQuestion, {"not_sensitive"}},
      {Phase::kConsent, {"agree"}},
      {Phase::kPosition, {"face_good"}},
      {Phase::kCountdown, {"tick"}},
      {Phase::kCapture, {"progress", "captured_good", "captured_moved", "captured_saturated", "captured_failed"}},
      {Phase::kGate, {"start"}},
      {Phase::kThanks, {"tick", "refuse"}},
      {Phase::kForgetting, {"captured_failed", "discarded"}},
      {Phase::kSelfcheck, {"checked"}}};
  static const std::map<std::string, VisitEvent> kPlain = TableEvents({});
  std::string name;
  if (random.Uniform() < 0.6) {
    const auto& lead = kLeadOn[static_cast<size_t>(state.phase)].second;
    name = lead[draw(lead.size())];
  } else {
    name = std::next(kPlain.begin(), static_cast<std::ptrdiff_t>(draw(kPlain.size())))->first;
  }
  return name == "tick" ? VisitEvent(event::Tick{state.armed}) : kPlain.at(name);
}

}  // namespace stratalux::rig
