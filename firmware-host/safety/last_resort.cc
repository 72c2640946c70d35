// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/safety/last_resort.h"

#include <array>
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

void OnFatal(int signal) {
  LightGuard::TakeAllForEver();
  // SA_RESETHAND has put the default action back; it comes when the handler returns and unblocks the signal.
  raise(signal);
}

void OnStop(int signal) {
  process_stop->Request(StopReason::kOperator);
  // The handler is gone for this one (SA_RESETHAND): the second is fatal.
  struct sigaction action {};
  action.sa_handler = OnFatal;
  action.sa_flags = static_cast<int>(SA_RESETHAND);
  sigemptyset(&action.sa_mask);
  sigaction(signal, &action, nullptr);
}

void Install(int signal, void (*handler)(int), int flags) {
  struct sigaction before {};
  sigaction(signal, nullptr, &before);
  if (before.sa_handler == SIG_IGN) return;
  struct sigaction action {};
  action.sa_handler = handler;
  action.sa_flags = static_cast<int>(SA_RESETHAND) | flags;
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
    for (const int signal : {SIGHUP, SIGQUIT, SIGPIPE, SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGSYS, SIGXCPU,
                             SIGXFSZ, SIGALRM, SIGUSR1, SIGUSR2})
      Install(signal, OnFatal, SA_ONSTACK);
    return true;
  }();
  static_cast<void>(installed);
  return stop;
}

}  // namespace stratalux::rig
