// SPDX-License-Identifier: Apache-2.0
// StopToken: why work on the rig must end, told once, to everything that waits.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>

#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {

enum class StopReason : uint8_t {
  kNone,
  kOperator,  // SIGINT, SIGTERM, the stop of a page
  kVisitorLeft,
  kEmergencyStop,
  kDoorOpen,
  kLinesGone,     // nobody can tell any more whether E-STOP or door are open
  kCameraGone,    // unplugged
  kLeaseExpired,  // nobody renewed the light's lease: the capture hangs
  kOnTimeLimit,   // a light was on for as long as it may be at a stretch
  kDying,         // a fatal signal: nothing is switched on again
};
[[nodiscard]] const char* ToString(StopReason reason);

class StopToken {
 public:
  StopToken();
  StopToken(const StopToken&) = delete;
  StopToken& operator=(const StopToken&) = delete;

  // The first reason stays; an operator's request behind it is not forgotten. Safe in a signal handler and from any
  // thread.
  void Request(StopReason reason) noexcept;
  [[nodiscard]] StopReason reason() const noexcept { return reason_.load(); }
  [[nodiscard]] bool stopped() const noexcept { return reason() != StopReason::kNone; }
  // The operator wants it to end, also where something else had stopped it before.
  [[nodiscard]] bool operator_asked() const noexcept {
    return operator_waits_.load() || reason() == StopReason::kOperator;
  }
  // kFailed with the reason once stopped.
  [[nodiscard]] Status Check() const;
  // Passes the time, or less once stopped. True: stopped.
  bool Sleep(std::chrono::nanoseconds time) const;
  // Readable from the moment it is stopped; for poll().
  [[nodiscard]] int fd() const noexcept { return event_.get(); }
  // For the next visit. Whoever resets has seen to it that the reason is gone. An operator's request that came behind
  // another reason is the reason then: nobody has answered it yet.
  void Reset() noexcept;

 private:
  std::atomic<StopReason> reason_ = StopReason::kNone;
  std::atomic<bool> operator_waits_ = false;
  UniqueFd event_;
  static_assert(std::atomic<StopReason>::is_always_lock_free, "a signal handler may only touch lock-free atomics");
};

}  // namespace stratalux::rig
