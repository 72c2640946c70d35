// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/safety/last_resort.h"

#include <array>
#include <atomic>
#include <csignal>
#include <cstddef>

#include <signal.h>
#include <unistd.h>

#include "firmware-host/safety/light_guard.h"

namespace stratalux::rig {
namespace {

StopToken* process_stop = nullptr;  // set before the first handler
// A handler of a stack overflow needs a stack of its own.
alignas(std::max_align_t) std::array<char, 64 * 1024> handler_stack;

std::atomic<bool> stop_told = false;

void OnFatal(int signal) {
  // Any thread may be told, and several at once: the handler stays until the light is off, whoever comes first.
  LightGuard::TakeAllForEver();
  struct sigaction action {};
  action.sa_handler = SIG_DFL;
  sigemptyset(&action.sa_mask);
  sigaction(signal, &action, nullptr);
  // The default action comes when the handler returns and unblocks the signal.
  raise(signal);
}

void OnStop(int signal) {
  // The second one is fatal.
  if (stop_told.exchange(true)) return OnFatal(signal);
  process_stop->Request(StopReason::kOperator);
}

void Install(int signal, void (*handler)(int), int flags) {
  struct sigaction before {};
  sigaction(signal, nullptr, &before);
  if (before.sa_handler == SIG_IGN) return;
  struct sigaction action {};
  action.sa_handler = handler;
  action.sa_flags = flags;
  sigemptyset(&action.sa_mask);
  sigaction(signal, &action, nullptr);
}

}  // namespace

StopToken& StopOfProcess() {
  static StopToken stop;
  static const bool installed = [] {
    process_stop = &stop;
    const stack_t stack{.ss_sp = handler_stack.data(), .ss_flags = 0, .ss_size = handler_stack.size()};
    sigaltstack(&stack, nullptr);
    for (const int signal : {SIGINT, SIGTERM}) Install(signal, OnStop, 0);
    // Whatever would end or freeze the process; a stop by Ctrl-Z ends it, too: frozen, nobody would watch the light.
    for (const int signal :
         {SIGHUP,  SIGQUIT, SIGPIPE, SIGSEGV,   SIGBUS,  SIGFPE, SIGILL, SIGABRT, SIGSYS,  SIGTRAP,
          SIGXCPU, SIGXFSZ, SIGALRM, SIGVTALRM, SIGPROF, SIGIO,  SIGPWR, SIGUSR1, SIGUSR2, SIGSTKFLT})
      Install(signal, OnFatal, SA_ONSTACK);
    for (const int signal : {SIGTSTP, SIGTTIN, SIGTTOU}) Install(signal, OnStop, 0);
    return true;
  }();
  static_cast<void>(installed);
  return stop;
}

}  // namespace stratalux::rig
