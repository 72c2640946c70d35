// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/kiosk/scripted_front.h"

#include <utility>

#include <sys/eventfd.h>
#include <unistd.h>

namespace stratalux::rig {

ScriptedFront::ScriptedFront(SimulatedRig& rig, int wanted, std::function<Manner(int)> next)
    : rig_(rig), wanted_(wanted), next_(std::move(next)), wake_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}

void ScriptedFront::Push(const VisitEvent& event) {
  waiting_.push_back(event);
  const uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = write(wake_.get(), &one, sizeof one);
}

// The operator comes by now and then while nobody can be served.
std::vector<VisitEvent> ScriptedFront::Take() {
  uint64_t count = 0;
  [[maybe_unused]] const ssize_t got = read(wake_.get(), &count, sizeof count);
  const auto clock = std::chrono::steady_clock::now();
  if ((screen_ == Phase::kSafe || screen_ == Phase::kClosed) && clock >= operator_at_ && !ended_) {
    operator_at_ = clock + std::chrono::milliseconds(50);
    rig_.Happen(RigSignal::kDoor, SignalLevel::kRest);
    rig_.Happen(RigSignal::kCamera, SignalLevel::kRest);
    waiting_.push_back(event::Operator{screen_ == Phase::kSafe ? OperatorCommand::kReset : OperatorCommand::kOpen});
  }
  return std::exchange(waiting_, {});
}

void ScriptedFront::Show(const action::Show& screen) {
  screen_ = screen.screen;
  if (on_show) on_show(screen);
  if (!visits.empty()) now().screens.push_back(screen.screen);
  Answer(screen);
}

void ScriptedFront::Answer(const action::Show& screen) {
  if (screen.screen == Phase::kIdle) {
    if (started_ || ended_) return;
    if (static_cast<int>(visits.size()) == wanted_) {
      ended_ = true;
      return Push(event::Shutdown{});
    }
    visits.push_back({next_(static_cast<int>(visits.size())), "", false, {}});
    started_ = true;
    return Push(event::Start{});
  }
  started_ = false;
  if (visits.empty()) return;
  const Manner manner = now().manner;
  switch (screen.screen) {
    case Phase::kQuestion:
      if (manner == Manner::kSensitive) return Push(event::Sensitive{});
      return Push(manner == Manner::kLeavesQuestion ? VisitEvent(event::Leave{}) : event::NotSensitive{});
    case Phase::kConsent:
      if (manner == Manner::kRefuses) return Push(event::Refuse{});
      if (manner == Manner::kLeavesConsent) return Push(event::Leave{});
      return Push(event::Agree{{true, true, false, 1, 0}});
    case Phase::kPosition:
      return manner == Manner::kLeavesPosition ? Push(event::Leave{}) : void();
    case Phase::kCountdown:
      return manner == Manner::kLeavesCountdown ? Push(event::Leave{}) : void();
    case Phase::kCapture:
      return screen.of > 0 && 2 * screen.number >= screen.of ? DuringCapture() : void();
    case Phase::kGate:
      return Push(event::Start{});
    case Phase::kThanks:
      if (manner == Manner::kWithdraws) now().gave_back = true;
      return Push(manner == Manner::kWithdraws ? VisitEvent(event::Refuse{}) : event::Leave{});
    default:
      return;
  }
}

void ScriptedFront::DuringCapture() {
  const Manner manner = std::exchange(now().manner, Manner::kVisit);
  if (manner == Manner::kLeavesCapture) return Push(event::Leave{});
  if (manner == Manner::kRefusesCapture) return Push(event::Refuse{});
  if (manner == Manner::kOpensDoor) return rig_.Happen(RigSignal::kDoor, SignalLevel::kActive);
  if (manner == Manner::kUnplugs) return rig_.Happen(RigSignal::kCamera, SignalLevel::kActive);
  now().manner = manner;
}

}  // namespace stratalux::rig
