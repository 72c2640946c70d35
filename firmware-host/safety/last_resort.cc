// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/safety/last_resort.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <csignal>
#include <cstddef>

#include <signal.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include "firmware-host/safety/light_guard.h"

namespace stratalux::rig {
namespace {

constexpr int kStopping[] = {SIGINT, SIGTERM, SIGTSTP, SIGTTIN, SIGTTOU};
constexpr int kFatal[] = {SIGHUP,  SIGQUIT, SIGPIPE, SIGSEGV,   SIGBUS,  SIGFPE, SIGILL, SIGABRT, SIGSYS,  SIGTRAP,
                          SIGXCPU, SIGXFSZ, SIGALRM, SIGVTALRM, SIGPROF, SIGIO,  SIGPWR, SIGUSR1, SIGUSR2, SIGSTKFLT};

StopToken* process_stop = nullptr;  // set before the first handler
int signals_fd = -1;                // set before a guard reads it
// A handler of a stack overflow needs a stack of its own.
alignas(std::max_align_t) std::array<char, 64 * 1024> handler_stack;

std::atomic<bool> stop_told = false;

// What the signal does by default, in this thread, whether or not it blocks the signal.
void Die(int signal) noexcept {
  struct sigaction action {};
  action.sa_handler = SIG_DFL;
  sigemptyset(&action.sa_mask);
  sigaction(signal, &action, nullptr);
  sigset_t one, before;
  sigemptyset(&one);
  sigaddset(&one, signal);
  raise(signal);
  pthread_sigmask(SIG_UNBLOCK, &one, &before);
  // Come to only by a signal that froze the process, once it was continued.
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
}

void OnFatal(int signal) {
  // Any thread may be told, and several at once: the handler stays until the light is off, whoever comes first.
  LightGuard::TakeAllForEver();
  Die(signal);
}

void OnStop(int signal) {
  // The second one is fatal.
  if (stop_told.exchange(true)) return OnFatal(signal);
  process_stop->Request(StopReason::kOperator);
}

// In the guard's thread: as the handlers would.
void AnswerPending() noexcept {
  signalfd_siginfo pending{};
  while (read(signals_fd, &pending, sizeof pending) == sizeof pending) {
    const int signal = static_cast<int>(pending.ssi_signo);
    const bool stops = std::find(std::begin(kStopping), std::end(kStopping), signal) != std::end(kStopping);
    stops ? OnStop(signal) : OnFatal(signal);
  }
}

// Adds the signal to `met`, unless it was ignored when the program began.
void Install(int signal, void (*handler)(int), int flags, sigset_t& met) {
  struct sigaction before {};
  sigaction(signal, nullptr, &before);
  if (before.sa_handler == SIG_IGN) return;
  struct sigaction action {};
  action.sa_handler = handler;
  action.sa_flags = flags;
  sigemptyset(&action.sa_mask);
  sigaction(signal, &action, nullptr);
  sigaddset(&met, signal);
}

}  // namespace

StopToken& StopOfProcess() {
  static StopToken stop;
  static const bool installed = [] {
    process_stop = &stop;
    handler_stack.fill(1);  // in memory from now on: who dies beside real-time threads has little time for page faults
    const stack_t stack{.ss_sp = handler_stack.data(), .ss_flags = 0, .ss_size = handler_stack.size()};
    sigaltstack(&stack, nullptr);
    sigset_t met;
    sigemptyset(&met);
    // Whatever would end or freeze the process; a stop by Ctrl-Z ends it, too: frozen, nobody would watch the light.
    for (const int signal : kStopping) Install(signal, OnStop, 0, met);
    for (const int signal : kFatal) Install(signal, OnFatal, SA_ONSTACK, met);
    // Without a descriptor the handlers alone answer.
    signals_fd = signalfd(-1, &met, SFD_CLOEXEC | SFD_NONBLOCK);
    if (signals_fd >= 0) LightGuard::MeetSignals(signals_fd, AnswerPending);
    return true;
  }();
  static_cast<void>(installed);
  return stop;
}

}  // namespace stratalux::rig
