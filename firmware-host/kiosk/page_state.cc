// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/page_state.h"

#include <algorithm>
#include <utility>

#include <nlohmann/json.hpp>

#include "shared/http/access.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
using Screens = EnumSet<Phase>;

constexpr auto kBetweenSteps = 200ms;   // of a progress
constexpr auto kBetweenPresses = 1s;    // a finger that taps twice
constexpr auto kGreetAgainAfter = 60s;  // after the last press

struct Verb {
  const char* name;
  Screens screens;
  VisitEvent event;
};

const std::vector<Verb>& Verbs() {
  static const std::vector<Verb> kVerbs = {
      {"start", {Phase::kIdle}, event::Start{}},
      {"not-sensitive", {Phase::kQuestion}, event::NotSensitive{}},
      {"sensitive", {Phase::kQuestion}, event::Sensitive{}},
      {"agree", {Phase::kConsent}, event::Agree{}},
      {"again", {Phase::kGate}, event::Start{}},
      {"keep", {Phase::kGate}, event::Leave{}},
      {"done", {Phase::kThanks}, event::Start{}},
      {"refuse", {Phase::kConsent, Phase::kGate, Phase::kThanks}, event::Refuse{}},
      {"leave",
       {Phase::kQuestion, Phase::kConsent, Phase::kPosition, Phase::kCountdown, Phase::kCapture},
       event::Leave{}}};
  return kVerbs;
}

bool AtRest(Phase phase) {
  return phase == Phase::kIdle || phase == Phase::kClosed || phase == Phase::kSafe || phase == Phase::kSelfcheck;
}

PressVerdict Refusal(int status, const std::string& reason) { return {status, reason, std::nullopt, false}; }

}  // namespace

bool PageState::Show(const action::Show& show, const std::string& fresh_nonce, Moment now) {
  const bool same = show.screen == shown_.screen && !nonce_.empty();
  const bool begins = AtRest(shown_.screen) && !AtRest(show.screen);
  const bool ends = !AtRest(shown_.screen) && AtRest(show.screen);
  const bool step = same && show.screen == Phase::kCapture && show.word == shown_.word && show.number < show.of;
  shown_ = show;
  if (begins) ++visit_;
  if ((begins || ends || nonce_.empty()) && !fresh_nonce.empty()) nonce_ = fresh_nonce;
  if (!same) pressed_.reset();
  if (!same) seen_ = false;
  if (show.screen != Phase::kThanks && !same) ticket_.clear();
  untold_ = step && told_ && now - *told_ < kBetweenSteps;
  if (untold_) return false;
  told_ = now;
  return true;
}

bool PageState::SetTicket(const std::string& code) {
  ticket_ = code;
  return shown_.screen == Phase::kThanks;
}

bool PageState::Rest(Moment now) {
  if (std::exchange(untold_, false)) return true;
  if (language_ == 0 || !AtRest(shown_.screen) || now - touched_ < kGreetAgainAfter) return false;
  language_ = 0;
  return true;
}

PressVerdict PageState::PressLanguage(const PagePress& press, Moment now) {
  constexpr Screens kBefore = {Phase::kSafe, Phase::kClosed, Phase::kIdle, Phase::kQuestion, Phase::kConsent};
  const auto found = std::find(languages_.begin(), languages_.end(), press.language);
  if (found == languages_.end()) return Refusal(400, "the kiosk does not speak '" + press.language + "'");
  if (!kBefore.Has(shown_.screen)) return Refusal(409, "the language must be chosen earlier");
  language_ = static_cast<size_t>(found - languages_.begin());
  touched_ = now;
  return {204, "", std::nullopt, true};
}

PressVerdict PageState::Press(const PagePress& press, Moment now) {
  const bool language = press.verb == "language";
  const auto& verbs = Verbs();
  const auto verb = std::find_if(verbs.begin(), verbs.end(), [&](const Verb& one) { return press.verb == one.name; });
  if (!language && verb == verbs.end()) return Refusal(404, "there is no button of that name");
  if (!http::SameSecret(press.nonce, nonce_)) return Refusal(403, "this was another visit's screen");
  if (press.screen != ToString(shown_.screen)) return Refusal(409, "another screen is shown by now");
  if (language) return PressLanguage(press, now);
  if (!verb->screens.Has(shown_.screen)) return Refusal(409, "this screen has nothing of that name");
  if (press.verb == "keep" && !shown_.usable) return Refusal(409, "there is nothing worth keeping");
  const bool leaves = std::holds_alternative<event::Leave>(verb->event);
  if (!leaves && pressed_ && now - *pressed_ < kBetweenPresses) return Refusal(409, "already pressed");
  pressed_ = now;
  touched_ = now;
  PressVerdict verdict{204, "", verb->event, false};
  if (auto* agree = std::get_if<event::Agree>(&*verdict.event))
    agree->choice = {true, press.research, press.publication, static_cast<uint8_t>(language_), 0};
  return verdict;
}

std::string PageState::Json() const {
  nlohmann::ordered_json json = {{"screen", ToString(shown_.screen)},
                                 {"word", ToString(shown_.word)},
                                 {"number", shown_.number},
                                 {"of", shown_.of},
                                 {"visit", visit_},
                                 {"nonce", nonce_},
                                 {"language", languages_[language_]}};
  auto& closures = json["closures"] = nlohmann::ordered_json::array();
  for (int i = 0; i < kClosures; ++i)
    if (shown_.closures.Has(static_cast<Closure>(i))) closures.push_back(ToString(static_cast<Closure>(i)));
  const FaceBox& box = shown_.box;
  if (shown_.screen == Phase::kPosition && box.right > box.left)
    json["box"] = {box.left, box.top, box.right, box.bottom};
  if (shown_.screen == Phase::kGate) json["usable"] = shown_.usable;
  if (shown_.screen == Phase::kPosition && seen_) json["preview"] = preview_;
  if (shown_.screen == Phase::kThanks && !ticket_.empty()) json["ticket"] = ticket_;
  if (shown_.closures.Has(Closure::kHours) && !opens_.empty()) json["opens"] = opens_;
  return json.dump();
}

}  // namespace stratalux::rig
