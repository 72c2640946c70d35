// SPDX-License-Identifier: Apache-2.0
// What signals do to a program that holds lights.
#pragma once

#include "firmware-host/safety/stop_token.h"

namespace stratalux::rig {

// The program's stop token, with handlers for the signals, installed once a process.
//   INT, TERM, TSTP, TTIN, TTOU                     stop the work (StopReason::kOperator); a second one is fatal
//   HUP, QUIT, PIPE, SEGV, BUS, FPE, ILL, ABRT,     fatal: LightGuard::TakeAllForEver, then what the signal does by
//   SYS, TRAP, XCPU, XFSZ, ALRM, VTALRM, PROF,      default; exceptions that nobody catches come here as ABRT
//   IO, PWR, USR1, USR2, STKFLT
// A signal that is sent to the process is met by the thread of a LightGuard, too: the thread that the kernel picks may
// get no processor for long, beside real-time threads, or wait in the kernel. What a thread does to itself, such as a
// fault, is answered by its own handler. Signals that were ignored when the program began (nohup) stay so. SIGKILL and
// SIGSTOP can be caught by nobody: `stratalux-rig safe` from ExecStopPost, and pull-downs, serve those.
[[nodiscard]] StopToken& StopOfProcess();

}  // namespace stratalux::rig
