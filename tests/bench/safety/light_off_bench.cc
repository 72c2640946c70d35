// SPDX-License-Identifier: Apache-2.0
// From the moment that light must go off to the ENABLE line that was written off, two projectors on the scripted lines
// of the safety tests: stops by token, E-STOP, door and leases that nobody renews, and deaths (deaths.cc), at random
// moments. Then the same on one processor beside a thread of SCHED_FIFO that never sleeps. Beside the guard a thread of
// ordinary priority that looks every 5 ms, as a watchdog without the right to real time would.
//   light_off_bench [STOPS [DEATHS]]   a row; 500 and 500. Real time needs the right to it (root, LimitRTPRIO)
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>
#include <thread>

#include <pthread.h>
#include <sched.h>

#include "tests/bench/safety/rows.h"
#include "tests/firmware-host/safety/guarded_gpio.h"

namespace stratalux::rig {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;

enum class Cause { kStop, kButton, kDoor, kLease };
constexpr const char* kNames[] = {"stop", "E-STOP", "door", "lease"};

Row MeasureGuard(Cause cause, int stops) {
  Row row;
  std::mt19937 random(7);
  for (int i = 0; i < stops; ++i) {
    StopToken stop;
    GuardedGpio rig(stop);
    const auto wait = microseconds(std::uniform_int_distribution<>(500, 20000)(random));
    const auto lease = cause == Cause::kLease ? std::chrono::nanoseconds(wait) : std::chrono::seconds(5);
    int64_t due = MonotonicNow().ns + std::chrono::nanoseconds(wait).count();
    if (!rig.guard->On(0, {lease, std::chrono::minutes(1)}).ok()) std::exit(1);
    if (!rig.guard->On(1, {lease, std::chrono::minutes(1)}).ok() && cause != Cause::kLease) std::exit(1);
    if (cause != Cause::kLease) {
      std::this_thread::sleep_for(wait);
      due = MonotonicNow().ns;
    }
    if (cause == Cause::kStop) stop.Request(StopReason::kOperator);
    if (cause == Cause::kButton) TheGpio().Raise(kEmergencyStop, true);
    if (cause == Cause::kDoor) TheGpio().Raise(kDoor, true);
    row.Add(GuardedGpio::DarkWithin(std::chrono::seconds(10)), due);
  }
  return row;
}

// What there was before: a thread that looks now and then.
Row MeasureWatchdog(int stops) {
  Row row;
  std::mt19937 random(7);
  StopToken none;
  for (int i = 0; i < stops; ++i) {
    GuardedGpio rig(none);
    rig.guard.reset();
    LightSwitch& light = *rig.lights->enable(0);
    std::atomic<bool> stopped = false, ended = false;
    std::thread watchdog([&] {
      const sched_param ordinary{};
      pthread_setschedparam(pthread_self(), SCHED_OTHER, &ordinary);
      while (!ended) {
        if (stopped) light.Set(false);
        std::this_thread::sleep_for(milliseconds(5));
      }
    });
    light.Set(true);
    std::this_thread::sleep_for(microseconds(std::uniform_int_distribution<>(500, 20000)(random)));
    const int64_t due = MonotonicNow().ns;
    stopped = true;
    row.Add(GuardedGpio::DarkWithin(std::chrono::seconds(10)), due);
    ended = true;
    watchdog.join();
  }
  return row;
}

void Measure(const char* what, int stops, int deaths) {
  for (const Cause cause : {Cause::kStop, Cause::kButton, Cause::kDoor, Cause::kLease})
    MeasureGuard(cause, stops).Print(what, kNames[static_cast<int>(cause)]);
  MeasureSignals(deaths).Print(what, "death by a signal from outside");
  MeasureFaults(what, deaths);
}

int Main(int stops, int deaths) {
  Measure("guard", stops, deaths);
  MeasureWatchdog(stops).Print("thread of 5 ms", "stop");

  cpu_set_t one;
  CPU_ZERO(&one);
  CPU_SET(0, &one);
  sched_setaffinity(0, sizeof one, &one);
  // Above the measuring thread, below the guard; the kernel leaves ordinary threads 5 % (sched_rt_runtime_us).
  sched_param own{.sched_priority = 60};
  std::atomic<bool> ended = false;
  std::thread spinning([&ended] {
    const sched_param priority{.sched_priority = 50};
    if (pthread_setschedparam(pthread_self(), SCHED_FIFO, &priority) != 0) {
      std::printf("no right to SCHED_FIFO: the rows beside a spinning thread are left out\n");
      return;
    }
    while (!ended) {
    }
  });
  std::this_thread::sleep_for(milliseconds(50));
  if (sched_setscheduler(0, SCHED_FIFO, &own) == 0) {
    Measure("guard, one CPU, beside FIFO 50", stops, deaths);
    MeasureWatchdog(std::min(stops, 20)).Print("thread of 5 ms, one CPU, FIFO 50", "stop");
  }
  ended = true;
  spinning.join();
  return 0;
}

}  // namespace
}  // namespace stratalux::rig

int main(int argc, char** argv) {
  const int stops = argc > 1 ? std::max(1, std::atoi(argv[1])) : 500;
  return stratalux::rig::Main(stops, argc > 2 ? std::max(1, std::atoi(argv[2])) : stops);
}
