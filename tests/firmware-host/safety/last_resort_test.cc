// SPDX-License-Identifier: Apache-2.0
// Deaths: a process that holds lights is ended in every way but SIGKILL, at random moments; its lines are off, and it
// still dies as it would have.
#include "firmware-host/safety/last_resort.h"

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <functional>
#include <new>
#include <stdexcept>
#include <thread>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "shared/base/check.h"
#include "shared/base/random.h"
#include "tests/firmware-host/safety/guarded_gpio.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
constexpr LightLease kLong = {.length = 1h, .longest = 2h};

// Runs `life` in a process of its own with both lights on; the signal that ended it, or minus its exit code.
int EndOf(const std::function<void(GuardedGpio&)>& life, const std::function<void(pid_t)>& meanwhile = {}) {
  new (&TheGpio()) ScriptedGpio;
  const pid_t child = fork();
  if (child == 0) {
    const int quiet = ::open("/dev/null", 1);
    dup2(quiet, STDERR_FILENO);
    const rlimit no_core{0, 0};
    setrlimit(RLIMIT_CORE, &no_core);
    GuardedGpio rig(StopOfProcess());
    if (!rig.guard->On(0, kLong).ok() || !rig.guard->On(1, kLong).ok()) _exit(99);
    life(rig);
    _exit(0);
  }
  if (meanwhile) meanwhile(child);
  int status = 0;
  EXPECT_EQ(waitpid(child, &status, 0), child);
  return WIFSIGNALED(status) ? WTERMSIG(status) : -WEXITSTATUS(status);
}

void AwaitLight() {
  for (int i = 0; i < 20000 && !(GuardedGpio::Lit(0) && GuardedGpio::Lit(1)); ++i) usleep(1000);
}

// With frames that the compiler cannot join.
__attribute__((noinline)) int Overflow(int depth) {
  volatile char room[4096];
  room[depth % 4096] = static_cast<char>(depth);
  return depth < 0 ? 0 : Overflow(depth + 1) + room[0];
}

TEST(LastResort, EveryFatalSignalTakesTheLightAndKillsAsBefore) {
  for (const int signal : {SIGHUP, SIGQUIT, SIGPIPE, SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGSYS, SIGXCPU, SIGXFSZ,
                           SIGALRM, SIGUSR1, SIGUSR2, SIGTRAP, SIGVTALRM, SIGPROF, SIGIO, SIGPWR}) {
    EXPECT_EQ(EndOf([signal](GuardedGpio&) {
                raise(signal);
                pause();
              }),
              signal);
    EXPECT_FALSE(GuardedGpio::Lit(0) || GuardedGpio::Lit(1)) << strsignal(signal);
  }
}

TEST(LastResort, OurOwnBugsAndExceptionsTakeTheLight) {
  const std::vector<std::pair<const char*, std::function<void(GuardedGpio&)>>> ends = {
      {"a failed check", [](GuardedGpio&) { SLX_CHECK(1 + 1 == 3); }},
      {"an exception of a thread", [](GuardedGpio&) { std::thread([] { throw std::runtime_error("sink"); }).join(); }},
      {"no memory in a thread", [](GuardedGpio&) { std::thread([] { throw std::bad_alloc(); }).join(); }},
      {"terminate", [](GuardedGpio&) { std::terminate(); }},
  };
  for (const auto& [name, life] : ends) {
    EXPECT_EQ(EndOf(life), SIGABRT) << name;
    EXPECT_FALSE(GuardedGpio::Lit(0) || GuardedGpio::Lit(1)) << name;
  }
  EXPECT_EQ(EndOf([](GuardedGpio&) { Overflow(1); }), SIGSEGV);
  EXPECT_FALSE(GuardedGpio::Lit(0) || GuardedGpio::Lit(1)) << "a stack overflow";
}

TEST(LastResort, TheFirstInterruptStopsAndTheSecondKills) {
  for (const int signal : {SIGINT, SIGTERM}) {
    EXPECT_EQ(EndOf([signal](GuardedGpio& rig) {
                raise(signal);
                if (StopOfProcess().reason() != StopReason::kOperator) _exit(1);
                if (!GuardedGpio::DarkWithin(20s)) _exit(2);
                if (rig.guard->On(0, kLong).ok()) _exit(3);
                if (!rig.guard->Reset().ok() || !rig.guard->On(0, kLong).ok()) _exit(4);
                raise(signal);
                pause();
              }),
              signal);
    EXPECT_FALSE(GuardedGpio::Lit(0) || GuardedGpio::Lit(1));
  }
}

TEST(LastResort, AProcessThatIsToBeFrozenIsStoppedFirst) {
  EXPECT_EQ(EndOf([](GuardedGpio&) {
              raise(SIGTSTP);
              _exit(GuardedGpio::DarkWithin(20s) && StopOfProcess().stopped() ? 0 : 1);
            }),
            0);
}

// A blocked standard error must hold nobody up.
TEST(LastResort, APipeThatNobodyReadsKeepsNoLightOn) {
  EXPECT_EQ(EndOf([](GuardedGpio&) {
              int ends[2];
              if (pipe(ends) != 0) _exit(98);
              dup2(ends[1], STDERR_FILENO);
              fcntl(ends[1], F_SETFL, O_NONBLOCK);
              const std::string full(65536, 'x');
              while (write(ends[1], full.data(), full.size()) > 0) {
              }
              fcntl(ends[1], F_SETFL, 0);
              std::thread([] { SLX_CHECK(1 + 1 == 3); }).detach();
              _exit(GuardedGpio::DarkWithin(20s) ? 0 : 1);
            }),
            0);
}

TEST(LastResort, DeathsAtRandomMomentsLeaveNoLight) {
  const char* seed = std::getenv("STRATALUX_SEED");
  const char* many = std::getenv("STRATALUX_DEATHS");
  Random random(seed != nullptr ? std::strtoull(seed, nullptr, 10) : 1, 0xdead);
  const int signals[] = {SIGHUP, SIGQUIT, SIGPIPE, SIGSEGV, SIGBUS, SIGABRT};
  const int deaths = many != nullptr ? std::atoi(many) : 500;
  for (int death = 0; death < deaths; ++death) {
    const int signal = signals[static_cast<int>(random.Uniform(0.0, 6.0))];
    const int after_us = static_cast<int>(random.Uniform(0.0, 3000.0));
    const int ended = EndOf(
        [](GuardedGpio& rig) {
          // The second signal finds another thread, whose mask has no hole in it.
          std::thread([] {
            while (true) pause();
          }).detach();
          for (int i = 0;; ++i) {
            static_cast<void>(rig.guard->On(i % 2, kLong));
            static_cast<void>(rig.bank->TriggerProjector(-1));
            static_cast<void>(rig.guard->Renew());
            if (i % 5 == 0) static_cast<void>(rig.guard->AllOff());
          }
        },
        [&](pid_t child) {
          AwaitLight();
          usleep(static_cast<useconds_t>(after_us));
          kill(child, signal);
          kill(child, signal);
        });
    ASSERT_EQ(ended, signal);
    ASSERT_FALSE(GuardedGpio::Lit(0) || GuardedGpio::Lit(1))
        << "death " << death << " by " << strsignal(signal) << " after " << after_us << " us";
  }
}

}  // namespace
}  // namespace stratalux::rig
