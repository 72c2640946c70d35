// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/events/rig_events.h"

#include <algorithm>
#include <cerrno>

#include <sys/eventfd.h>
#include <unistd.h>

#include "shared/base/check.h"

namespace stratalux::rig {
namespace {

size_t At(RigSignal signal) { return static_cast<size_t>(signal); }

}  // namespace

const char* RigEvent::ToString() const {
  const bool active = level == SignalLevel::kActive;
  switch (signal) {
    case RigSignal::kStart:
      return "START pressed";
    case RigSignal::kDoor:
      return active ? "door open" : "door closed";
    case RigSignal::kEmergencyStop:
      return active ? "E-STOP pressed" : "E-STOP released";
    case RigSignal::kCamera:
      return active ? "camera unplugged" : "camera plugged in";
    case RigSignal::kLines:
      return active ? "GPIO lines gone" : "GPIO lines back";
  }
  return "unknown";
}

RigEvents::RigEvents(StopToken& stop) : stop_(stop), wake_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  SLX_CHECK(wake_.ok());
}

void RigEvents::Wake() noexcept {
  const int before = errno;
  const uint64_t one = 1;
  // Refused only where the counter is full: then it is readable.
  static_cast<void>(!write(wake_.get(), &one, sizeof one));
  errno = before;
}

void RigEvents::Tell(RigSignal signal, SignalLevel level, MonotonicNs time) noexcept {
  Latch& latch = latches_[At(signal)];
  const auto active = static_cast<uint64_t>(level == SignalLevel::kActive);
  uint64_t word = latch.word.load();
  if ((word & 1U) == active) return;
  latch.edge_ns[active].store(time.ns);
  do {
    if ((word & 1U) == active) return;
  } while (!latch.word.compare_exchange_weak(word, (word ^ 1U) + 2));
  if (signal == RigSignal::kCamera && active != 0) {
    ++camera_losses_;
    stop_.Request(StopReason::kCameraGone);
  }
  Wake();
}

void RigEvents::TellMoment(RigSignal signal, MonotonicNs time) noexcept {
  Tell(signal, SignalLevel::kActive, time);
  Tell(signal, SignalLevel::kRest, time);
}

void RigEvents::PressStart(MonotonicNs time) noexcept {
  uint64_t presses = presses_.load();
  do {
    if ((presses & kOccupied) != 0) {
      ++dropped_starts_;
      return;
    }
    if (presses == 0) press_ns_.store(time.ns);
  } while (!presses_.compare_exchange_weak(presses, presses + 1));
  Wake();
}

void RigEvents::TakeFrom(RigSignal signal, std::vector<RigEvent>& events) {
  Latch& latch = latches_[At(signal)];
  const uint64_t word = latch.word.fetch_and(1);
  const uint64_t edges = word >> 1U, now = word & 1U;
  if (edges == 0) return;
  const int64_t last_ns = latch.edge_ns[now].load();
  auto tell = [&](uint64_t level, int64_t time_ns) {
    events.push_back({signal, level != 0 ? SignalLevel::kActive : SignalLevel::kRest, {time_ns}});
  };
  // It is as it was when it was last taken: what was between is told, too.
  const bool there_and_back = edges % 2 == 0;
  // (A next edge may have left its time already.)
  if (there_and_back) tell(now ^ 1U, std::min(latch.edge_ns[now ^ 1U].load(), last_ns));
  tell(now, last_ns);
  merged_ += static_cast<int64_t>(edges) - (there_and_back ? 2 : 1);
}

std::vector<RigEvent> RigEvents::Take() {
  uint64_t count = 0;
  // Before the latches: what is told meanwhile makes it readable again.
  while (read(wake_.get(), &count, sizeof count) < 0 && errno == EINTR) {
  }
  std::vector<RigEvent> events;
  for (int i = 0; i < kRigSignals; ++i) {
    const auto signal = static_cast<RigSignal>(i);
    if (signal != RigSignal::kStart) TakeFrom(signal, events);
  }
  const int64_t pressed_ns = press_ns_.load();
  const uint64_t presses = presses_.fetch_and(kOccupied) & ~kOccupied;
  if (presses > 0) {
    events.push_back({RigSignal::kStart, SignalLevel::kActive, {pressed_ns}});
    merged_ += static_cast<int64_t>(presses) - 1;
  }
  std::stable_sort(events.begin(), events.end(), [](const RigEvent& a, const RigEvent& b) { return a.time < b.time; });
  return events;
}

bool RigEvents::IsActive(RigSignal signal) const noexcept { return (latches_[At(signal)].word.load() & 1U) != 0; }

RigEvents::Occupied::Occupied(RigEvents& events) noexcept : events_(events), before_(events.dropped_starts_.load()) {
  events_.dropped_starts_ += static_cast<int64_t>(events_.presses_.exchange(kOccupied) & ~kOccupied);
}

RigEvents::Occupied::~Occupied() { events_.presses_.store(0); }

int64_t RigEvents::Occupied::dropped() const noexcept { return events_.dropped_starts_.load() - before_; }

}  // namespace stratalux::rig
