// SPDX-License-Identifier: Apache-2.0
// RigEvents: what a visitor, an operator or a cable does to the rig, on a descriptor for poll().
//
// Whoever sees it tells it: the light's guard (door, E-STOP), the lines' watcher (START), NodeWatch (camera), the
// simulated rig. Telling takes no lock, allocates nothing and never waits. Nothing overflows, however long nobody
// reads: of each signal at most two events wait, and what came and went between is merged and counted. The last event
// of a signal always says how it is now, and one that became active is told even if it was for a moment.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <string>
#include <vector>

#include "firmware-host/safety/stop_token.h"
#include "shared/base/unique_fd.h"
#include "shared/units/time.h"

namespace stratalux::rig {

enum class RigSignal : uint8_t {
  kStart,          // active: pressed. An event for a press, none for its end
  kDoor,           // open
  kEmergencyStop,  // pressed
  kCamera,         // unplugged
  kLines,          // the GPIO chip is gone
};
inline constexpr int kRigSignals = 5;
enum class SignalLevel : uint8_t { kRest, kActive };

struct RigEvent {
  RigSignal signal = RigSignal::kStart;
  SignalLevel level = SignalLevel::kActive;
  MonotonicNs time;  // CLOCK_MONOTONIC, of the edge where the kernel stamps it, else when it was seen

  // "door open", "E-STOP released", "camera unplugged"
  [[nodiscard]] const char* ToString() const;
  friend bool operator==(const RigEvent&, const RigEvent&) = default;
};

class RigEvents {
 public:
  // An unplugged camera stops the work (StopReason::kCameraGone); `stop` outlives it. Door, E-STOP and lines are the
  // LightGuard's to act on.
  explicit RigEvents(StopToken& stop);
  RigEvents(const RigEvents&) = delete;
  RigEvents& operator=(const RigEvents&) = delete;

  // From any thread, and signal handlers. How the signal is now; the same again is no event.
  void Tell(RigSignal signal, SignalLevel level, MonotonicNs time) noexcept;
  // It was active for a moment, and is at rest.
  void TellMoment(RigSignal signal, MonotonicNs time) noexcept;
  // A press of START. Presses that nobody has read yet are one.
  void PressStart(MonotonicNs time) noexcept;

  // Readable when there may be something to take.
  [[nodiscard]] int fd() const noexcept { return wake_.get(); }
  // What happened since the last call, by time. For one reader: what one took, no other gets.
  [[nodiscard]] std::vector<RigEvent> Take();
  // As last told, whether taken or not.
  [[nodiscard]] bool IsActive(RigSignal signal) const noexcept;
  // How often the camera went: who opened it anew before the last time has a dead one.
  [[nodiscard]] int64_t camera_losses() const noexcept { return camera_losses_.load(); }
  // Events that others stood for.
  [[nodiscard]] int64_t merged() const noexcept { return merged_.load(); }

  // While one lives, START is no event: presses are counted and gone, so is one that nobody had read. One at a time.
  class Occupied {
   public:
    explicit Occupied(RigEvents& events) noexcept;
    ~Occupied();
    Occupied(const Occupied&) = delete;
    Occupied& operator=(const Occupied&) = delete;
    // Presses that were dropped since it began.
    [[nodiscard]] int64_t dropped() const noexcept;

   private:
    RigEvents& events_;
    const int64_t before_;
  };
  // Presses that met an occupied rig.
  [[nodiscard]] int64_t dropped_starts() const noexcept { return dropped_starts_.load(); }

 private:
  static constexpr uint64_t kOccupied = uint64_t{1} << 63;

  // Bit 0: active; above it: edges since it was last taken.
  struct Latch {
    std::atomic<uint64_t> word = 0;
    std::array<std::atomic<int64_t>, 2> edge_ns{};  // the latest to each level
  };
  void Wake() noexcept;
  void TakeFrom(RigSignal signal, std::vector<RigEvent>& events);

  StopToken& stop_;
  UniqueFd wake_;
  std::array<Latch, kRigSignals> latches_;  // kStart's is not used
  std::atomic<uint64_t> presses_ = 0;       // kOccupied, and below it those nobody has read
  std::atomic<int64_t> press_ns_ = 0;       // the first of them
  std::atomic<int64_t> merged_ = 0, dropped_starts_ = 0, camera_losses_ = 0;
  static_assert(std::atomic<uint64_t>::is_always_lock_free && std::atomic<int64_t>::is_always_lock_free,
                "the light's guard takes no lock");
};

}  // namespace stratalux::rig
