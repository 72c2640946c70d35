// SPDX-License-Identifier: Apache-2.0
// Visitors and an operator of a kiosk, as a script has them: each screen is answered as drawn by a seed.
#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "firmware-host/kiosk/kiosk_front.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/random.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {

// What one visitor does. `kVisit`: all that is asked.
enum class Manner {
  kVisit,
  kSensitive,
  kRefuses,
  kLeavesQuestion,
  kLeavesConsent,
  kLeavesPosition,
  kLeavesCountdown,
  kLeavesCapture,
  kRefusesCapture,
  kWithdraws,  // with the ticket in hand
  kOpensDoor,  // during the capture
  kUnplugs     // the camera, likewise
};
inline constexpr int kManners = 12;

struct ScriptedVisit {
  Manner manner = Manner::kVisit;
  std::string ticket;
  bool gave_back = false;
  std::vector<Phase> screens;
};

class ScriptedFront final : public KioskFront {
 public:
  // `next` gives each visitor's manner, by number from 0; after `visits` of them the operator stops the kiosk.
  ScriptedFront(SimulatedRig& rig, int visits, std::function<Manner(int)> next);

  [[nodiscard]] int fd() const override { return wake_.get(); }
  std::vector<VisitEvent> Take() override;
  void Show(const action::Show& screen) override;
  bool GiveTicket(const std::string& code) override {
    if (!has_paper) return false;
    now().ticket = code;
    return true;
  }
  void TellOperator(Word word) override { ++told[word]; }
  void Preview(const FrameRecord& /*record*/, const Image<uint16_t>& /*pixels*/) override {
    if (on_preview) on_preview();
  }

  std::vector<ScriptedVisit> visits;
  std::map<Word, int> told;
  bool has_paper = true;  // tickets can be handed out
  std::function<void(const action::Show&)> on_show;
  std::function<void()> on_preview;  // on the worker's thread
  // Beside the script.
  void Push(const VisitEvent& event);

 private:
  ScriptedVisit& now() { return visits.back(); }
  void Answer(const action::Show& screen);
  void DuringCapture();

  SimulatedRig& rig_;
  const int wanted_;
  const std::function<Manner(int)> next_;
  UniqueFd wake_;
  std::vector<VisitEvent> waiting_;
  Phase screen_ = Phase::kClosed;
  bool started_ = false, ended_ = false;
  std::chrono::steady_clock::time_point operator_at_;
};

}  // namespace stratalux::rig
