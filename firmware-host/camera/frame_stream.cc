// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/camera/frame_stream.h"

#include <ctime>

namespace stratalux::rig {
namespace {

// Some drivers stamp the end of a frame ahead of it (vivid by most of a frame); a wrapped clock is off by much more.
constexpr auto kAhead = std::chrono::seconds(1);

}  // namespace

std::chrono::nanoseconds TimeSuspended() {
  timespec boot{}, monotonic{};
  clock_gettime(CLOCK_BOOTTIME, &boot);
  clock_gettime(CLOCK_MONOTONIC, &monotonic);
  const int64_t ns = (boot.tv_sec - monotonic.tv_sec) * 1'000'000'000LL + boot.tv_nsec - monotonic.tv_nsec;
  return std::chrono::nanoseconds(ns > 1'000'000 ? ns : 0);  // less is the time between the two calls
}

int64_t FrameStream::Number(uint32_t driver_number) {
  if (!number_) {
    number_ = driver_number;
  } else if (!driver_number_) {
    number_ = *number_ + 2;
  } else {
    number_ = *number_ + static_cast<int32_t>(driver_number - *driver_number_);
  }
  driver_number_ = driver_number;
  return *number_;
}

bool FrameStream::StampFits(MonotonicNs stamp, MonotonicNs now) {
  if (now + kAhead < stamp || (stamp_ && stamp < *stamp_)) return false;
  stamp_ = stamp;
  return true;
}

}  // namespace stratalux::rig
