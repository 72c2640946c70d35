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

  // The first reason stays. Safe in a signal handler and from any thread.
  void Request(StopReason reason) noexcept;
  [[nodiscard]] StopReason reason() const noexcept { return reason_.load(); }
  [[nodiscard]] bool stopped() const noexcept { return reason() != StopReason::kNone; }
  // kFailed with the reason once stopped.
  [[nodiscard]] Status Check() const;
  // Passes the time, or less once stopped. True: stopped.
  bool Sleep(std::chrono::nanoseconds time) const;
  // Readable from the moment it is stopped; for poll().
  [[nodiscard]] int fd() const noexcept { return event_.get(); }
  // For the next visit. Whoever resets has seen to it that the reason is gone.
  void Reset() noexcept;

 private:
  std::atomic<StopReason> reason_ = StopReason::kNone;
  UniqueFd event_;
  static_assert(std::atomic<StopReason>::is_always_lock_free, "a signal handler may only touch lock-free atomics");
};

}  // namespace stratalux::rig
