// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/safety/stop_token.h"

#include <algorithm>
#include <cerrno>

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "shared/base/check.h"

namespace stratalux::rig {

const char* ToString(StopReason reason) {
  switch (reason) {
    case StopReason::kNone:
      return "not stopped";
    case StopReason::kOperator:
      return "interrupted";
    case StopReason::kVisitorLeft:
      return "the visitor left";
    case StopReason::kEmergencyStop:
      return "emergency stop";
    case StopReason::kDoorOpen:
      return "door open";
    case StopReason::kLinesGone:
      return "GPIO lines gone";
    case StopReason::kCameraGone:
      return "the camera was unplugged";
    case StopReason::kLeaseExpired:
      return "no progress while a light was on";
    case StopReason::kOnTimeLimit:
      return "a light was on for as long as it may be";
    case StopReason::kDying:
      return "the program is ending";
  }
  return "unknown";
}

StopToken::StopToken() : event_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) { SLX_CHECK(event_.ok()); }

void StopToken::Request(StopReason reason) noexcept {
  const int before = errno;
  StopReason none = StopReason::kNone;
  // Requested again after the descriptor was read by nobody: it stays readable, nothing to do.
  if (reason_.compare_exchange_strong(none, reason)) {
    const uint64_t one = 1;
    // Cannot fail: the counter is far from full. Whoever only polls the reason sees it all the same.
    if (write(event_.get(), &one, sizeof one) != sizeof one) errno = before;
  } else if (reason == StopReason::kOperator && none != StopReason::kOperator) {
    operator_waits_.store(true);
    // Reset meanwhile: it looked before this was said.
    if (!stopped() && operator_waits_.exchange(false)) Request(StopReason::kOperator);
  }
  errno = before;
}

Status StopToken::Check() const {
  const StopReason why = reason();
  return why == StopReason::kNone ? Status::Ok() : Status::Failed(ToString(why));
}

bool StopToken::Sleep(std::chrono::nanoseconds time) const {
  const auto end = std::chrono::steady_clock::now() + time;
  while (!stopped()) {
    const std::chrono::nanoseconds left = end - std::chrono::steady_clock::now();
    if (left.count() <= 0) return false;
    const timespec limit{.tv_sec = static_cast<time_t>(left.count() / 1'000'000'000),
                         .tv_nsec = static_cast<long>(left.count() % 1'000'000'000)};
    pollfd event{event_.get(), POLLIN, 0};
    ppoll(&event, 1, &limit, nullptr);
  }
  return true;
}

void StopToken::Reset() noexcept {
  uint64_t count = 0;
  reason_.store(StopReason::kNone);
  // EAGAIN: it was not stopped.
  while (read(event_.get(), &count, sizeof count) < 0 && errno == EINTR) {
  }
  // Requested anew meanwhile: the event that was read may have been that one's.
  const uint64_t one = 1;
  if (stopped()) static_cast<void>(!write(event_.get(), &one, sizeof one));
  if (operator_waits_.exchange(false)) Request(StopReason::kOperator);
}

}  // namespace stratalux::rig
