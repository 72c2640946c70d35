// SPDX-License-Identifier: Apache-2.0
// From the moment that light must go off to the switch that was written off: the light's guard on the real clock, its
// switches scripted. Stops by token, by E-STOP and by a lease that nobody renews, at random moments; then the same on
// one processor beside a thread of SCHED_FIFO that never sleeps. Beside the guard a thread of ordinary priority that
// looks every 5 ms, as a watchdog without the right to real time would.
//   light_off_bench [STOPS]      500 a row; real time needs the right to it (root, LimitRTPRIO)
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include <pthread.h>
#include <sched.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "firmware-host/safety/light_guard.h"

namespace stratalux::rig {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::microseconds;
using std::chrono::milliseconds;

int64_t NowNs() { return Clock::now().time_since_epoch().count(); }

class TimedSwitch final : public LightSwitch {
 public:
  int Set(bool on) noexcept override {
    if (!on && on_.exchange(false)) off_at_.store(NowNs());
    if (on) on_.store(true);
    return 0;
  }
  int Read(bool& on) noexcept override {
    on = on_.load();
    return 0;
  }
  [[nodiscard]] const char* name() const noexcept override { return "ENABLE0"; }
  [[nodiscard]] bool on() const { return on_.load(); }
  [[nodiscard]] int64_t off_at() const { return off_at_.load(); }

 private:
  std::atomic<bool> on_ = false;
  std::atomic<int64_t> off_at_ = 0;
};

class Button final : public InterlockInput {
 public:
  Button() : fd_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}
  ~Button() override { close(fd_); }
  [[nodiscard]] int fd() const noexcept override { return fd_; }
  StopReason Take() noexcept override {
    uint64_t count = 0;
    static_cast<void>(!read(fd_, &count, sizeof count));
    return pressed_.load() ? StopReason::kEmergencyStop : StopReason::kNone;
  }
  void Press(bool down) {
    pressed_.store(down);
    const uint64_t one = 1;
    static_cast<void>(!write(fd_, &one, sizeof one));
  }

 private:
  int fd_;
  std::atomic<bool> pressed_ = false;
};

enum class Cause { kStop, kButton, kLease };
constexpr const char* kNames[] = {"stop", "E-STOP", "lease"};

bool WaitUntilOff(const TimedSwitch& light) {
  const auto deadline = Clock::now() + std::chrono::seconds(10);
  while (light.on() && Clock::now() < deadline) std::this_thread::sleep_for(microseconds(200));
  return !light.on();
}

struct Row {
  std::vector<double> ms;
  int never = 0;
  void Print(const char* what, const char* cause) {
    std::sort(ms.begin(), ms.end());
    std::printf("%-34s %-7s %5zu stops  median %7.3f ms  99 %% %7.3f ms  worst %7.3f ms%s\n", what, cause, ms.size(),
                ms[ms.size() / 2], ms[ms.size() * 99 / 100], ms.back(),
                never > 0 ? ("  NEVER OFF: " + std::to_string(never)).c_str() : "");
  }
};

Row MeasureGuard(Cause cause, int stops) {
  Row row;
  std::mt19937 random(7);
  for (int i = 0; i < stops; ++i) {
    StopToken stop;
    TimedSwitch light;
    Button button;
    auto guard = LightGuard::Start({{&light}}, &button, stop);
    if (!guard.ok()) {
      std::fprintf(stderr, "%s\n", guard.status().message().c_str());
      std::exit(1);
    }
    const auto wait = microseconds(std::uniform_int_distribution<>(500, 20000)(random));
    const auto lease = cause == Cause::kLease ? std::chrono::nanoseconds(wait) : std::chrono::seconds(5);
    const int64_t lit = NowNs();
    if (!(*guard)->On(0, {lease, std::chrono::minutes(1)}).ok()) std::exit(1);
    int64_t due = lit + std::chrono::nanoseconds(wait).count();
    if (cause != Cause::kLease) {
      std::this_thread::sleep_for(wait);
      due = NowNs();
    }
    if (cause == Cause::kStop) stop.Request(StopReason::kOperator);
    if (cause == Cause::kButton) button.Press(true);
    row.never += !WaitUntilOff(light);
    row.ms.push_back(1e-6 * static_cast<double>(light.off_at() - due));
  }
  return row;
}

// What there was before: a thread that looks now and then.
Row MeasureWatchdog(int stops) {
  Row row;
  std::mt19937 random(7);
  for (int i = 0; i < stops; ++i) {
    TimedSwitch light;
    std::atomic<bool> stopped = false, ended = false;
    std::thread watchdog([&] {
      while (!ended) {
        if (stopped) light.Set(false);
        std::this_thread::sleep_for(milliseconds(5));
      }
    });
    light.Set(true);
    std::this_thread::sleep_for(microseconds(std::uniform_int_distribution<>(500, 20000)(random)));
    const int64_t due = NowNs();
    stopped = true;
    if (!WaitUntilOff(light)) {
      ++row.never;
      light.Set(false);
    }
    row.ms.push_back(1e-6 * static_cast<double>(light.off_at() - due));
    ended = true;
    watchdog.join();
  }
  return row;
}

void Measure(const char* what, int stops) {
  for (const Cause cause : {Cause::kStop, Cause::kButton, Cause::kLease})
    MeasureGuard(cause, stops).Print(what, kNames[static_cast<int>(cause)]);
}

int Main(int stops) {
  Measure("guard", stops);
  MeasureWatchdog(stops).Print("thread that looks every 5 ms", "stop");

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
      std::printf("no right to SCHED_FIFO: the row beside a spinning thread is left out\n");
      return;
    }
    while (!ended) {
    }
  });
  std::this_thread::sleep_for(milliseconds(50));
  if (sched_setscheduler(0, SCHED_FIFO, &own) == 0) {
    Measure("guard, one CPU, beside FIFO 50", stops);
    MeasureWatchdog(std::min(stops, 20)).Print("thread of 5 ms, one CPU, FIFO 50", "stop");
  }
  ended = true;
  spinning.join();
  return 0;
}

}  // namespace
}  // namespace stratalux::rig

int main(int argc, char** argv) { return stratalux::rig::Main(argc > 1 ? std::max(1, std::atoi(argv[1])) : 500); }
