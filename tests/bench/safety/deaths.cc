// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <functional>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>

#include <fcntl.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "firmware-host/safety/last_resort.h"
#include "shared/base/check.h"
#include "shared/units/time.h"
#include "tests/bench/safety/rows.h"
#include "tests/firmware-host/safety/guarded_gpio.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
constexpr int kSignals[] = {SIGHUP,  SIGQUIT, SIGPIPE, SIGSEGV,   SIGBUS,  SIGFPE,  SIGILL, SIGABRT,
                            SIGSYS,  SIGTRAP, SIGXCPU, SIGXFSZ,   SIGALRM, SIGPROF, SIGIO,  SIGVTALRM,
                            SIGUSR1, SIGPWR,  SIGUSR2, SIGSTKFLT, SIGINT,  SIGTERM};

void WriteToNobody(std::atomic<int64_t>& due_ns) {
  int ends[2];
  if (pipe(ends) != 0) _exit(98);
  close(ends[0]);
  due_ns.store(MonotonicNow().ns);
  static_cast<void>(!write(ends[1], "x", 1));
}

struct Fault {
  const char* name;
  int signal;
  void (*make)(std::atomic<int64_t>& due_ns);
};
constexpr Fault kFaults[] = {
    {"death by a null pointer", SIGSEGV,
     [](std::atomic<int64_t>& due_ns) {
       due_ns.store(MonotonicNow().ns);
       *static_cast<volatile int*>(nullptr) = 1;
     }},
    {"death by a broken pipe", SIGPIPE, WriteToNobody},
    {"death by a failed check", SIGABRT,
     [](std::atomic<int64_t>& due_ns) {
       due_ns.store(MonotonicNow().ns);
       SLX_CHECK(1 + 1 == 3);
     }},
    // Until the search for a handler has ended, nobody knows that it is a death.
    {"death by an exception", SIGABRT,
     [](std::atomic<int64_t>& due_ns) {
       static std::atomic<int64_t>* due = &due_ns;
       static const std::terminate_handler before = std::get_terminate();
       std::set_terminate([] {
         due->store(MonotonicNow().ns);
         before();
       });
       throw std::runtime_error("sink");
     }},
};

// A thread that has worked has its stack in memory.
__attribute__((noinline)) void TouchStack() {
  volatile char stack[65536];
  for (size_t i = 0; i < sizeof stack; i += 1024) stack[i] = 0;
}

// A process with both lights on whose main thread is at work at an ordinary priority; beside it runs `beside`.
pid_t Live(const std::function<void()>& beside) {
  TheGpio().lines[kEnable0].level.store(0);  // of the process before
  const pid_t child = fork();
  if (child != 0) return child;
  dup2(::open("/dev/null", O_WRONLY), STDERR_FILENO);
  const rlimit no_core{0, 0};
  setrlimit(RLIMIT_CORE, &no_core);
  GuardedGpio rig(StopOfProcess());
  if (!rig.guard->On(1, kLongLease).ok() || !rig.guard->On(0, kLongLease).ok()) _exit(99);
  const sched_param ordinary{};
  sched_setscheduler(0, SCHED_OTHER, &ordinary);
  if (beside) std::thread(beside).detach();
  while (true) {
    static_cast<void>(rig.guard->Renew());
    static_cast<void>(rig.bank->TriggerProjector(-1));
  }
}

// Waits for the death by `signal`; beside a spinning thread it gets the processor for that, now that all is measured.
bool Bury(pid_t child, int signal) {
  std::error_code gone;
  const sched_param urgent{.sched_priority = 70};
  for (const auto& task : std::filesystem::directory_iterator("/proc/" + std::to_string(child) + "/task", gone))
    sched_setscheduler(std::stoi(task.path().filename()), SCHED_FIFO, &urgent);
  int status = 0;
  return waitpid(child, &status, 0) == child && WIFSIGNALED(status) && WTERMSIG(status) == signal &&
         GuardedGpio::ReadBackDark();
}

Row MeasureFault(const Fault& fault, int deaths) {
  Row row;
  std::mt19937 random(7);
  void* shared = mmap(nullptr, sizeof(std::atomic<int64_t>), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  SLX_CHECK(shared != MAP_FAILED);
  auto& due_ns = *new (shared) std::atomic<int64_t>(0);
  for (int i = 0; i < deaths; ++i) {
    const auto wait_us = std::uniform_int_distribution<useconds_t>(500, 20000)(random);
    due_ns.store(0);
    const pid_t child = Live([&due_ns, make = fault.make, wait_us] {
      TouchStack();
      usleep(wait_us);
      make(due_ns);
    });
    for (int tries = 0; due_ns.load() == 0 && tries < 300000; ++tries) usleep(100);
    const bool dark = due_ns.load() != 0 && GuardedGpio::DarkWithin(10s);
    if (!dark) kill(child, SIGKILL);
    row.Add(Bury(child, fault.signal) && dark, due_ns.load());
  }
  munmap(shared, sizeof(std::atomic<int64_t>));
  return row;
}

bool BothLit() { return GuardedGpio::Lit(0) && GuardedGpio::Lit(1); }

}  // namespace

void Row::Add(bool dark, int64_t due_ns) {
  if (!dark) {
    ++never_;
    return;
  }
  const int64_t off_ns =
      std::max(TheGpio().lines[kEnable0].changed_ns.load(), TheGpio().lines[kEnable1].changed_ns.load());
  ms_.push_back(1e-6 * static_cast<double>(off_ns - due_ns));
}

void Row::Print(const char* what, const char* cause) {
  std::sort(ms_.begin(), ms_.end());
  if (ms_.empty()) ms_.push_back(-1.0);
  std::printf("%-32s %-32s %4zu times  median %8.3f ms  99 %% %8.3f ms  worst %8.3f ms%s\n", what, cause, ms_.size(),
              ms_[ms_.size() / 2], ms_[ms_.size() * 99 / 100], ms_.back(),
              never_ > 0 ? ("  NEVER OFF, OR NO RIGHT DEATH: " + std::to_string(never_)).c_str() : "");
  std::fflush(stdout);
}

Row MeasureSignals(int deaths) {
  Row row;
  std::mt19937 random(7);
  for (int i = 0; i < deaths; ++i) {
    const int signal = kSignals[i % std::size(kSignals)];
    const pid_t child = Live({});
    while (!BothLit()) usleep(100);
    usleep(std::uniform_int_distribution<useconds_t>(500, 20000)(random));
    const int64_t due_ns = MonotonicNow().ns;
    kill(child, signal);
    const bool dark = GuardedGpio::DarkWithin(10s);
    const ScriptedGpio::Line& line = TheGpio().lines[kEnable0];
    const int64_t off_ns = line.changed_ns.load();
    if (!dark)
      kill(child, SIGKILL);
    else if (signal == SIGINT || signal == SIGTERM)
      kill(child, signal);  // the first one stopped its work
    row.Add(Bury(child, signal) && dark && off_ns == line.changed_ns.load(), due_ns);
  }
  return row;
}

void MeasureFaults(const char* what, int deaths) {
  for (const Fault& fault : kFaults) MeasureFault(fault, deaths).Print(what, fault.name);
}

}  // namespace stratalux::rig
