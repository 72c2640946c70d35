// SPDX-License-Identifier: Apache-2.0
// Keeps other programs from delaying a capture: while it lives, the calling thread runs under SCHED_FIFO and all memory
// of the process stays in RAM. Threads started meanwhile are scheduled as usual.
#pragma once

#include <memory>

#include "shared/base/result.h"

namespace stratalux::rig {

class RealtimeThread {
 public:
  // `priority`: 1 .. 99. kFailed, with the remedy, where the account may not; nothing is changed then.
  static Result<std::unique_ptr<RealtimeThread>> Enter(int priority);
  RealtimeThread(const RealtimeThread&) = delete;
  RealtimeThread& operator=(const RealtimeThread&) = delete;
  // On the thread that entered.
  ~RealtimeThread();

 private:
  RealtimeThread() = default;
};

}  // namespace stratalux::rig
