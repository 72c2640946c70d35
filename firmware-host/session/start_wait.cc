// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/start_wait.h"

#include <array>
#include <chrono>
#include <string>

#include <poll.h>

namespace stratalux::rig {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kLookMs = 10;  // a token that is stopped stays readable: nothing wakes us for the operator
constexpr auto kReopenPause = std::chrono::milliseconds(250);

class StartWait {
 public:
  StartWait(CaptureStation& station, StopToken& stop, Logger& logger)
      : station_(station), stop_(stop), logger_(logger) {}

  Status Run() {
    SLX_RETURN_IF_ERROR(station_.light().AllOff());
    // START of before is nobody's; a camera that went and came is to be opened again.
    for (const RigEvent& event : station_.events().Take()) reopen_ |= event.signal == RigSignal::kCamera;
    reopen_ |= stop_.reason() == StopReason::kCameraGone;
    logger_.Info("waiting for START, all lights off");
    for (int i = 0; i < kRigSignals; ++i) {
      const auto signal = static_cast<RigSignal>(i);
      if (station_.events().IsActive(signal)) Note({signal, SignalLevel::kActive, {}});
    }
    while (true) {
      SLX_RETURN_IF_ERROR(MayGoOn());
      Recover();
      Sleep();
      for (const RigEvent& event : station_.events().Take()) {
        if (event.signal != RigSignal::kStart) {
          Note(event);
          continue;
        }
        const std::string against = WhatSpeaksAgainst();
        if (against.empty()) return stop_.Check();
        logger_.Warning("START refused: " + against);
      }
    }
  }

 private:
  void Note(const RigEvent& event) {
    const bool active = event.level == SignalLevel::kActive;
    active_[static_cast<size_t>(event.signal)] = active;
    if (event.signal == RigSignal::kCamera) reopen_ = true;
    if (active)
      logger_.Warning(std::string(event.ToString()) + ": START is refused until that is over");
    else
      logger_.Info(event.ToString());
  }
  // An error where no door to close and no plug to put in helps.
  [[nodiscard]] Status MayGoOn() const {
    if (stop_.operator_asked()) return Status::Failed(ToString(StopReason::kOperator));
    // Nothing opens them again.
    if (active_[static_cast<size_t>(RigSignal::kLines)]) return Status::Failed(ToString(StopReason::kLinesGone));
    switch (stop_.reason()) {
      case StopReason::kNone:
      case StopReason::kDoorOpen:
      case StopReason::kEmergencyStop:
      case StopReason::kCameraGone:
        return Status::Ok();
      default:
        return stop_.Check();
    }
  }
  [[nodiscard]] std::string WhatSpeaksAgainst() const {
    std::string against;
    for (int i = 0; i < kRigSignals; ++i)
      if (active_[i])
        against += (against.empty() ? "" : ", ") +
                   std::string(RigEvent{static_cast<RigSignal>(i), SignalLevel::kActive, {}}.ToString());
    if (!against.empty()) return against;
    if (stop_.stopped()) return ToString(stop_.reason());
    return reopen_ ? "the camera is not open yet" : "";
  }
  // Once nothing is active any more.
  void Recover() {
    for (const bool active : active_)
      if (active) return;
    if (reopen_) {
      if (Clock::now() < next_try_) return;
      next_try_ = Clock::now() + kReopenPause;
    } else if (!stop_.stopped()) {
      return;
    }
    const Status recovered = reopen_ ? station_.ReopenCamera() : station_.light().Reset();
    if (recovered.ok()) {
      reopen_ = false;
      said_.clear();
      if (!stop_.stopped()) logger_.Info("START is accepted again");
      return;
    }
    if (said_ != recovered.message()) logger_.Warning(recovered.message());
    said_ = recovered.message();
  }
  void Sleep() const {
    const bool stopped = stop_.stopped();
    std::array<pollfd, 2> fds = {pollfd{station_.events().fd(), POLLIN, 0},
                                 pollfd{stopped ? -1 : stop_.fd(), POLLIN, 0}};
    poll(fds.data(), fds.size(), stopped || reopen_ ? kLookMs : -1);
  }

  CaptureStation& station_;
  StopToken& stop_;
  Logger& logger_;
  std::array<bool, kRigSignals> active_{};
  bool reopen_ = false;  // the camera went since it was opened
  Clock::time_point next_try_;
  std::string said_;
};

}  // namespace

Status AwaitStart(CaptureStation& station, StopToken& stop, Logger& logger) {
  return StartWait(station, stop, logger).Run();
}

}  // namespace stratalux::rig
