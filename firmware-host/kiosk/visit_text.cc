// SPDX-License-Identifier: Apache-2.0
// Events, actions and states as words, for logs, tests and the plain front.
#include <string>

#include "firmware-host/kiosk/visit_actions.h"
#include "firmware-host/kiosk/visit_events.h"
#include "firmware-host/kiosk/visit_state.h"

namespace stratalux::rig {
namespace {

std::string Of(const CaptureFacts& facts) {
  static constexpr const char* kWorth[] = {"complete", "degraded", "failed"};
  std::string text = kWorth[static_cast<size_t>(facts.worth)];
  if (facts.light_taken) text += " light_taken";
  if (facts.unproven) text += " unproven";
  if (facts.lamp) text += " lamp";
  if (facts.mixed_up) text += " mixed_up";
  if (facts.moved) text += " moved";
  if (facts.saturated_permille > 0) text += " saturated=" + std::to_string(facts.saturated_permille);
  if (facts.coverage_permille < 1000) text += " coverage=" + std::to_string(facts.coverage_permille);
  return text;
}

std::string Of(const ConsentChoice& choice) {
  return std::string(choice.fit ? " fit" : "") + (choice.research ? " research" : "") +
         (choice.publication ? " publication" : "");
}

std::string Of(const EnumSet<Closure>& closures) {
  std::string text;
  for (int i = 0; i < kClosures; ++i)
    if (closures.Has(static_cast<Closure>(i)))
      text += (text.empty() ? "" : ",") + std::string(ToString(static_cast<Closure>(i)));
  return text;
}

struct EventText {
  std::string operator()(const event::Start& /*e*/) const { return "start"; }
  std::string operator()(const event::NotSensitive& /*e*/) const { return "not_sensitive"; }
  std::string operator()(const event::Sensitive& /*e*/) const { return "sensitive"; }
  std::string operator()(const event::Agree& e) const { return "agree" + Of(e.choice); }
  std::string operator()(const event::Refuse& /*e*/) const { return "refuse"; }
  std::string operator()(const event::Leave& /*e*/) const { return "leave"; }
  std::string operator()(const event::Face& e) const {
    return "face " + std::to_string(e.box.left) + "," + std::to_string(e.box.top) + "," + std::to_string(e.box.right) +
           "," + std::to_string(e.box.bottom) + " " + std::to_string(e.distance_mm) +
           "mm level=" + std::to_string(e.level_permille) + " " + std::to_string(e.exposure_us) + "us";
  }
  std::string operator()(const event::NoFace& /*e*/) const { return "no_face"; }
  std::string operator()(const event::Tick& e) const { return std::string("tick ") + ToString(e.deadline); }
  std::string operator()(const event::Progress& e) const {
    return "progress " + std::to_string(e.done) + "/" + std::to_string(e.of);
  }
  std::string operator()(const event::Captured& e) const { return "captured " + Of(e.facts); }
  std::string operator()(const event::Failed& e) const { return e.light_taken ? "failed light_taken" : "failed"; }
  std::string operator()(const event::Discarded& /*e*/) const { return "discarded"; }
  std::string operator()(const event::DiscardFailed& /*e*/) const { return "discard_failed"; }
  std::string operator()(const event::Checked& e) const {
    return std::string(e.passed ? "checked passed" : "checked failed") + (e.drifted ? ", drifted" : "") +
           (e.light_taken ? ", light_taken" : "");
  }
  std::string operator()(const event::Recovered& e) const { return e.good ? "recovered" : "recovered not"; }
  std::string operator()(const event::InterlockChanged& e) const {
    return std::string(ToString(e.which)) + (e.active ? " active" : " over");
  }
  std::string operator()(const event::DeviceChanged& e) const {
    return std::string(ToString(e.which)) + (e.there ? " back" : " lost");
  }
  std::string operator()(const event::Space& e) const { return "space " + std::to_string(e.bytes); }
  std::string operator()(const event::Calibration& e) const {
    return e.there ? "calibration " + std::to_string(e.age_days) + "d" : "calibration none";
  }
  std::string operator()(const event::Hours& e) const { return e.open ? "hours open" : "hours closed"; }
  std::string operator()(const event::Operator& e) const { return std::string("operator ") + ToString(e.command); }
  std::string operator()(const event::PageLost& /*e*/) const { return "page_lost"; }
  std::string operator()(const event::PageBack& /*e*/) const { return "page_back"; }
  std::string operator()(const event::ClockJumped& /*e*/) const { return "clock_jumped"; }
  std::string operator()(const event::Leftover& /*e*/) const { return "leftover"; }
  std::string operator()(const event::Shutdown& /*e*/) const { return "shutdown"; }
};

struct ActionText {
  std::string operator()(const action::LightOff& /*a*/) const { return "light_off"; }
  std::string operator()(const action::Preview& /*a*/) const { return "preview"; }
  std::string operator()(const action::CheckRig& /*a*/) const { return "check_rig"; }
  std::string operator()(const action::Recover& /*a*/) const { return "recover"; }
  std::string operator()(const action::StartCapture& a) const {
    return "start_capture " + std::to_string(a.attempt) + " " + std::to_string(a.exposure_us) + "us" + Of(a.consent);
  }
  std::string operator()(const action::StopCapture& a) const {
    return std::string("stop_capture ") + ToString(a.reason);
  }
  std::string operator()(const action::Discard& a) const { return std::string("discard ") + ToString(a.reason); }
  std::string operator()(const action::Show& a) const {
    std::string text = std::string("show ") + ToString(a.screen) + " " + ToString(a.word);
    if (a.of > 0) text += " " + std::to_string(a.number) + "/" + std::to_string(a.of);
    if (a.usable) text += " usable";
    return a.closures.empty() ? text : text + " " + Of(a.closures);
  }
  std::string operator()(const action::PrintTicket& /*a*/) const { return "print_ticket"; }
  std::string operator()(const action::TellOperator& a) const { return std::string("tell ") + ToString(a.word); }
  std::string operator()(const action::Count& a) const { return std::string("count ") + ToString(a.end); }
  std::string operator()(const action::Arm& a) const { return std::string("arm ") + ToString(a.deadline); }
};

}  // namespace

std::string ToString(const VisitEvent& event) { return std::visit(EventText(), event); }
std::string ToString(const VisitAction& action) { return std::visit(ActionText(), action); }

std::string ToString(const VisitState& state) {
  static constexpr const char* kLight[] = {"dark", "preview", "patterns", "check"};
  static constexpr const char* kWork[] = {"nothing", "capture", "discard", "recover", "reset", "check"};
  static constexpr const char* kSessions[] = {"none", "begun", "kept"};
  std::string text = std::string(ToString(state.phase)) + " " + ToString(state.word);
  text += "; visit " + std::to_string(state.visit) + ", attempt " + std::to_string(state.attempt) + ", sessions " +
          kSessions[static_cast<size_t>(state.sessions)] + (state.consented ? ", consented" : "");
  text += std::string("; ") + kLight[static_cast<size_t>(state.light)] + ", waits for " +
          kWork[static_cast<size_t>(state.work)] + ", armed " + ToString(state.armed);
  const std::string closures = Of(state.closed_for);
  text += "; closed for " + (closures.empty() ? "nothing" : closures) + ", safe for " + ToString(state.safe_for);
  if (!state.interlock.empty()) text += ", interlock open";
  return text;
}

}  // namespace stratalux::rig
