// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/kiosk/page_script.h"

#include <cmath>

#include "shared/image/png.h"
#include "tests/firmware-host/kiosk/visit_cases.h"

namespace stratalux::rig {

Result<std::unique_ptr<ScriptedKiosk>> ScriptedKiosk::Start(const KioskPageOptions& options, Logger& logger) {
  std::unique_ptr<ScriptedKiosk> kiosk(new ScriptedKiosk);
  kiosk->rules_ = TableRules();
  KioskPageInput input;
  input.event = [self = kiosk.get()](const VisitEvent& event) {
    const std::lock_guard lock(self->mutex_);
    self->pressed_.push_back(event);
    self->StepOn(event);
  };
  input.withdraw = [](const std::string& ticket) {
    return ticket == kScriptedTicket ? Status::Ok() : Status::NotFound("no ticket '" + ticket + "'");
  };
  // Nothing is pressed before it is there: the screens' first nonce comes with it.
  const std::lock_guard lock(kiosk->mutex_);
  SLX_ASSIGN_OR_RETURN(kiosk->page_, KioskPage::Start(options, input, logger));
  return kiosk;
}

void ScriptedKiosk::StepOn(const VisitEvent& event) {
  VisitStep step = Step(rules_, state_, event);
  state_ = step.state;
  for (const VisitAction& action : step.actions) {
    if (const auto* show = std::get_if<action::Show>(&action)) page_->Show(*show);
    if (std::holds_alternative<action::PrintTicket>(action)) page_->ShowTicket(kScriptedTicket);
    if (const auto* tell = std::get_if<action::TellOperator>(&action)) page_->Tell(tell->word);
  }
}

void ScriptedKiosk::Happen(const VisitEvent& event) {
  const std::lock_guard lock(mutex_);
  StepOn(event);
}

bool ScriptedKiosk::Happen(const std::string& name) {
  const std::lock_guard lock(mutex_);
  const auto events = TableEvents(state_);
  const auto found = events.find(name);
  if (found != events.end()) StepOn(found->second);
  return found != events.end();
}

void ScriptedKiosk::Open() {
  for (const char* good : {"hours_open", "space_good", "calibration_good"}) Happen(good);
}

VisitState ScriptedKiosk::state() const {
  const std::lock_guard lock(mutex_);
  return state_;
}

std::vector<VisitEvent> ScriptedKiosk::pressed() const {
  const std::lock_guard lock(mutex_);
  return pressed_;
}

Result<ScriptedFrame> FrameOf(const std::filesystem::path& png) {
  int bits = 0;
  SLX_ASSIGN_OR_RETURN(const auto picture, ReadPng(png, &bits));
  ScriptedFrame frame;
  frame.record.format = PixelFormat::kMono12;
  frame.record.cfa = Cfa::kMono;
  frame.pixels = Image<uint16_t>(picture.width(), picture.height());
  const double white = std::exp2(bits) - 1.0;
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      const int green = picture.channels() > 1 ? 1 : 0;
      frame.pixels(x, y) = static_cast<uint16_t>(4095.0 * std::pow(picture(x, y, green) / white, 2.2));
    }
  }
  return frame;
}

}  // namespace stratalux::rig
