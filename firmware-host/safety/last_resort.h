// SPDX-License-Identifier: Apache-2.0
// What signals do to a program that holds lights.
#pragma once

#include "firmware-host/safety/stop_token.h"

namespace stratalux::rig {

// The program's stop token, with handlers for the signals, installed once a process.
//   INT, TERM                                       stop the work (StopReason::kOperator); a second one is fatal
//   HUP, QUIT, PIPE, SEGV, BUS, FPE, ILL, ABRT,     fatal: LightGuard::TakeAllForEver, then what the signal does by
//   SYS, XCPU, XFSZ, ALRM, USR1, USR2               default; exceptions that nobody catches come here as ABRT
// Signals that were ignored when the program began (nohup) stay so. SIGKILL and SIGSTOP can be caught by nobody:
// `stratalux-rig safe` from ExecStopPost, and pull-downs, serve those.
[[nodiscard]] StopToken& StopOfProcess();

}  // namespace stratalux::rig
