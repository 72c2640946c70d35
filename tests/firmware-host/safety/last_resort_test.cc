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
#include <utility>
#include <vector>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "shared/base/check.h"
#include "shared/base/random.h"
#include "tests/firmware-host/safety/guarded_gpio.h"
#include "tests/support/sanitized.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
constexpr auto kLivesAtMost = 60s;
constexpr int kFatal[] = {SIGHUP,  SIGQUIT, SIGPIPE, SIGSEGV, SIGBUS,  SIGFPE,    SIGILL,  SIGABRT, SIGSYS, SIGXCPU,
                          SIGXFSZ, SIGALRM, SIGUSR1, SIGUSR2, SIGTRAP, SIGVTALRM, SIGPROF, SIGIO,   SIGPWR, SIGSTKFLT};

// Runs `life` in a process of its own with both lights on; the signal that ended it (SIGKILL: it lived too long), or
// minus its exit code.
int EndOf(const std::function<void(GuardedGpio&)>& life, const std::function<void(pid_t)>& meanwhile = {}) {
  new (&TheGpio()) ScriptedGpio;
  const pid_t child = fork();
  if (child == 0) {
    const int quiet = ::open("/dev/null", 1);
    dup2(quiet, STDERR_FILENO);
    const rlimit no_core{0, 0};
    setrlimit(RLIMIT_CORE, &no_core);
    GuardedGpio rig(StopOfProcess());
    if (!rig.guard->On(0, kLongLease).ok() || !rig.guard->On(1, kLongLease).ok()) _exit(99);
    life(rig);
    _exit(0);
  }
  if (meanwhile) meanwhile(child);
  int status = 0;
  pid_t ended = 0;
  for (const auto end = std::chrono::steady_clock::now() + kLivesAtMost; ended == 0; usleep(50)) {
    ended = waitpid(child, &status, WNOHANG);
    if (ended == 0 && std::chrono::steady_clock::now() > end) kill(child, SIGKILL);
  }
  EXPECT_EQ(ended, child);
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
  for (const int signal : kFatal) {
    EXPECT_EQ(EndOf([signal](GuardedGpio&) {
                raise(signal);
                pause();
              }),
              signal);
    EXPECT_TRUE(GuardedGpio::ReadBackDark()) << strsignal(signal);
  }
}

// The thread that the kernel picks waits for a vfork's child, out of reach of every signal but SIGKILL, as one does
// that gets no processor.
void BeOutOfReach() {
  if (vfork() == 0) {  // NOLINT(clang-analyzer-security.insecureAPI.vfork): for this very wait
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    while (true) pause();
  }
}

TEST(LastResort, ASignalSentToAThreadThatCannotAnswerIsMetByTheGuard) {
  for (const int signal : kFatal) {
    EXPECT_EQ(EndOf([](GuardedGpio&) { BeOutOfReach(); },
                    [signal](pid_t child) {
                      AwaitLight();
                      usleep(5000);  // it is on its way out of reach; earlier it would answer itself
                      kill(child, signal);
                    }),
              signal);
    EXPECT_TRUE(GuardedGpio::ReadBackDark()) << strsignal(signal);
  }
}

TEST(LastResort, TheGuardMeetsTheFirstInterruptAndTheSecond) {
  for (const int signal : {SIGINT, SIGTERM}) {
    EXPECT_EQ(EndOf([signal](GuardedGpio& rig) {
                sigset_t all;
                sigfillset(&all);
                pthread_sigmask(SIG_BLOCK, &all, nullptr);
                std::thread([&rig, signal] {
                  usleep(5000);  // as above
                  kill(getpid(), signal);
                  if (!GuardedGpio::DarkWithin(20s)) _exit(1);
                  if (StopOfProcess().reason() != StopReason::kOperator) _exit(2);
                  if (!rig.guard->Reset().ok() || !rig.guard->On(0, kLongLease).ok()) _exit(3);
                  kill(getpid(), signal);
                }).detach();
                pthread_sigmask(SIG_UNBLOCK, &all, nullptr);
                BeOutOfReach();
              }),
              signal);
    EXPECT_TRUE(GuardedGpio::ReadBackDark());
  }
}

TEST(LastResort, WhatWasIgnoredFromTheStartStaysSo) {
  ::signal(SIGHUP, SIG_IGN);  // as nohup has it
  EXPECT_EQ(EndOf([](GuardedGpio&) {
              sigset_t hangup;
              sigemptyset(&hangup);
              sigaddset(&hangup, SIGHUP);
              pthread_sigmask(SIG_BLOCK, &hangup, nullptr);  // pending, where others could take it
              raise(SIGHUP);
              kill(getpid(), SIGHUP);
              if (GuardedGpio::DarkWithin(200ms)) _exit(1);
              kill(getpid(), SIGUSR1);
              pause();
            }),
            SIGUSR1);
  ::signal(SIGHUP, SIG_DFL);
  EXPECT_TRUE(GuardedGpio::ReadBackDark());
}

// Faults, in a thread that has no stack for handlers.
const std::vector<std::pair<const char*, std::pair<int, void (*)()>>> kOwnFaults = {
    {"a null pointer", {SIGSEGV, [] { *static_cast<volatile int*>(nullptr) = 1; }}},
    {"a mapping past its file",
     {SIGBUS,
      [] {
        const int file = memfd_create("empty", MFD_CLOEXEC);
        void* page = mmap(nullptr, 4096, PROT_READ, MAP_SHARED, file, 0);
        static_cast<void>(*static_cast<volatile char*>(page));
      }}},
    {"a pipe without a reader",
     {SIGPIPE,
      [] {
        int ends[2];
        if (pipe(ends) != 0) _exit(98);
        close(ends[0]);
        static_cast<void>(!write(ends[1], "x", 1));
      }}},
    {"a file that grew too large",
     {SIGXFSZ,
      [] {
        const rlimit none{0, 0};
        setrlimit(RLIMIT_FSIZE, &none);
        static_cast<void>(!write(fileno(tmpfile()), "x", 1));
      }}},
    {"an exception", {SIGABRT, [] { throw std::runtime_error("sink"); }}},
    {"no memory", {SIGABRT, [] { throw std::bad_alloc(); }}},
    {"a failed check", {SIGABRT, [] { SLX_CHECK(1 + 1 == 3); }}},
};

TEST(LastResort, AFaultIsAnsweredByTheThreadThatMadeIt) {
  if (kUnderAddressSanitizer) GTEST_SKIP() << "sanitizers end the process before the fault's own signal does";
  for (const auto& [name, fault] : kOwnFaults) {
    EXPECT_EQ(EndOf([&fault](GuardedGpio&) { std::thread(fault.second).join(); }), fault.first) << name;
    EXPECT_TRUE(GuardedGpio::ReadBackDark()) << name;
  }
}

TEST(LastResort, ABugOfTheMainThreadTakesTheLight) {
  EXPECT_EQ(EndOf([](GuardedGpio&) { SLX_CHECK(1 + 1 == 3); }), SIGABRT);
  EXPECT_TRUE(GuardedGpio::ReadBackDark()) << "a failed check";
  EXPECT_EQ(EndOf([](GuardedGpio&) { std::terminate(); }), SIGABRT);
  EXPECT_TRUE(GuardedGpio::ReadBackDark()) << "terminate";
  EXPECT_EQ(EndOf([](GuardedGpio&) { Overflow(1); }), SIGSEGV);
  EXPECT_TRUE(GuardedGpio::ReadBackDark()) << "a stack overflow";
}

TEST(LastResort, TheFirstInterruptStopsAndTheSecondKills) {
  for (const int signal : {SIGINT, SIGTERM}) {
    EXPECT_EQ(EndOf([signal](GuardedGpio& rig) {
                raise(signal);
                if (StopOfProcess().reason() != StopReason::kOperator) _exit(1);
                if (!GuardedGpio::DarkWithin(20s)) _exit(2);
                if (rig.guard->On(0, kLongLease).ok()) _exit(3);
                if (!rig.guard->Reset().ok() || !rig.guard->On(0, kLongLease).ok()) _exit(4);
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
  if (kUnderAddressSanitizer) GTEST_SKIP() << "AddressSanitizer answers faults itself";
  const char* seed = std::getenv("STRATALUX_SEED");
  const char* many = std::getenv("STRATALUX_DEATHS");
  Random random(seed != nullptr ? std::strtoull(seed, nullptr, 10) : 1, 0xdead);
  const int deaths = many != nullptr ? std::atoi(many) : 500;
  for (int death = 0; death < deaths; ++death) {
    // Every third one is of the program's own making.
    const int outside = static_cast<int>(random.Uniform(0.0, static_cast<double>(std::size(kFatal))));
    const size_t own = static_cast<size_t>(random.Uniform(0.0, static_cast<double>(kOwnFaults.size())));
    const auto& [name, fault] = kOwnFaults[own];
    const bool from_outside = death % 3 != 0;
    const int signal = from_outside ? kFatal[outside] : fault.first;
    const int after_us = static_cast<int>(random.Uniform(0.0, 3000.0));
    const int ended = EndOf(
        [&](GuardedGpio& rig) {
          // The second signal finds another thread, whose mask has no hole in it.
          std::thread([&, dies = fault.second] {
            if (!from_outside) {
              usleep(static_cast<useconds_t>(after_us));
              dies();
            }
            while (true) pause();
          }).detach();
          for (int i = 0;; ++i) {
            static_cast<void>(rig.guard->On(i % 2, kLongLease));
            static_cast<void>(rig.bank->TriggerProjector(-1));
            static_cast<void>(rig.guard->Renew());
            if (i % 5 == 0) static_cast<void>(rig.guard->AllOff());
          }
        },
        [&](pid_t child) {
          if (!from_outside) return;
          AwaitLight();
          usleep(static_cast<useconds_t>(after_us));
          kill(child, signal);
          kill(child, signal);
        });
    ASSERT_EQ(ended, signal);
    ASSERT_TRUE(GuardedGpio::ReadBackDark())
        << "death " << death << " by " << (from_outside ? strsignal(signal) : name) << " after " << after_us << " us";
  }
}

}  // namespace
}  // namespace stratalux::rig
