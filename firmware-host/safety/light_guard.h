// SPDX-License-Identifier: Apache-2.0
// LightGuard: the one owner of everything that makes light.
//
// A light is on under a lease: whoever wants it renews the lease, step by step. A thread of the highest priority takes
// the light away when the lease ends, when the work is stopped (StopToken), when E-STOP or door open. That thread never
// logs, allocates or waits for a lock. 'Off' is always tried, whatever failed before, on every switch, again and again
// until the hardware says dark. While the work is stopped nothing can be switched on.
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <memory>
#include <thread>
#include <vector>

#include "firmware-host/safety/light_switch.h"
#include "firmware-host/safety/stop_token.h"
#include "shared/base/result.h"
#include "shared/base/unique_fd.h"
#include "shared/units/time.h"

namespace stratalux::rig {

struct LightLease {
  std::chrono::nanoseconds length = std::chrono::seconds(2);   // from On, and from each Renew
  std::chrono::nanoseconds longest = std::chrono::minutes(5);  // at a stretch, however often it is renewed; 0: no limit
};

// The clock that leases run on.
class LeaseClock {
 public:
  virtual ~LeaseClock() = default;
  [[nodiscard]] virtual MonotonicNs Now() const noexcept = 0;
};

struct LightGuardOptions {
  // How often the switches are read back and leases are looked at, while a light is on or something is wrong, and
  // while all is dark. E-STOP, door and stop do not wait for it.
  std::chrono::nanoseconds watch_period = std::chrono::milliseconds(5);
  std::chrono::nanoseconds rest_period = std::chrono::milliseconds(50);
  // Null: CLOCK_MONOTONIC. A rig with a clock of its own brings it.
  const LeaseClock* clock = nullptr;
};

class LightGuard {
 public:
  static constexpr int kMaxProjectors = 16;
  static constexpr int kMaxSwitches = 4;  // of a projector
  static constexpr int kMaxGuards = 16;   // of a process

  // `projectors`: the switches of each; a projector is dark when all of its switches are off. `interlock` may be null.
  // Everything outlives the guard. Begins with all switches off; kFailed where one cannot be switched off, kBusy where
  // this process has a guard already (fatal signals must know whose light to take).
  static Result<std::unique_ptr<LightGuard>> Start(std::vector<std::vector<LightSwitch*>> projectors,
                                                   InterlockInput* interlock, StopToken& stop,
                                                   LightGuardOptions options = {});
  // All off; tried for a second at most.
  ~LightGuard();
  LightGuard(const LightGuard&) = delete;
  LightGuard& operator=(const LightGuard&) = delete;

  // kFailed while stopped, and where a switch refuses; the projector is dark then.
  Status On(int projector, const LightLease& lease);
  // Every light that is on, for another length of its lease. kFailed once stopped.
  Status Renew();
  // kFailed where a switch cannot be written or read back; the guard goes on trying.
  Status Off(int projector);
  Status AllOff();
  // Looks at the interlock at once and at what was asked to stop: kFailed with the reason, with all lights off.
  Status Check();
  // After a stop, for the next visit. kFailed while E-STOP or door are active.
  Status Reset();
  [[nodiscard]] StopToken& stop() const noexcept { return stop_; }
  // Of the clock that leases run on.
  [[nodiscard]] MonotonicNs Now() const noexcept;
  // False: the account may not use SCHED_FIFO, so that the guard's thread competes with others.
  [[nodiscard]] bool realtime() const noexcept { return realtime_.load(); }

  // Every light of this process's guards off, now, from wherever it is called: async-signal-safe. Nothing can be
  // switched on afterwards.
  static void TakeAllForEver() noexcept;
  // Signals of the process, met by the guards' threads: once `fd` is readable, `answer` takes what is pending. `fd`
  // must not block, and stays open. Once a process, from any thread.
  static void MeetSignals(int fd, void (*answer)() noexcept) noexcept;

 private:
  struct Light {
    std::array<LightSwitch*, kMaxSwitches> switches{};
    int count = 0;
    std::atomic<int64_t> length_ns = 0;   // of its lease
    std::atomic<int64_t> limit_ns = 0;    // end of the longest stretch
    std::atomic<int64_t> until_ns = 0;    // end of the lease; 0: must be dark
    std::atomic<bool> confirmed = false;  // read back dark since
    std::atomic<int> error = 0;           // errno of the last failed write or reading
    std::atomic<LightSwitch*> failed = nullptr;
  };

  LightGuard(StopToken& stop, InterlockInput* interlock, LightGuardOptions options);
  // False: there is no place left.
  bool Register() noexcept;
  void TakeForEver() noexcept;
  // Takes what the interlock and the leases say to the token.
  void Look() noexcept;
  // Writes those of the projector's switches off that may wait, or the others, and reads them back; true when all of
  // these say dark.
  bool Darken(Light& light, bool waiting) noexcept;
  // Darkens whatever must be dark; true: all of that says so. A light whose switch cannot be read stops the work.
  bool Enforce() noexcept;
  // How long nothing but an event needs looking at.
  [[nodiscard]] std::chrono::nanoseconds Pause(bool enforced) const noexcept;
  [[nodiscard]] Status MayBeLit(int projector) const;
  void Watch() noexcept;

  StopToken& stop_;
  InterlockInput* const interlock_;
  const LightGuardOptions options_;
  std::array<Light, kMaxProjectors> lights_;
  int count_ = 0;
  std::atomic<int> switching_ = 0;  // threads between asking whether light may be and having made it
  std::atomic<bool> watching_ = false, ending_ = false, realtime_ = false;
  UniqueFd wake_;
  std::thread thread_;

  static std::array<std::atomic<LightGuard*>, kMaxGuards> guards;
  static std::atomic<bool> dying;
  static std::atomic<void (*)() noexcept> answer_signals;
  static std::atomic<int> signals_fd;  // -1: nobody's
};

}  // namespace stratalux::rig
