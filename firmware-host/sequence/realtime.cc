// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/realtime.h"

#include <cerrno>
#include <cstring>
#include <string>

#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>

namespace stratalux::rig {

Result<std::unique_ptr<RealtimeThread>> RealtimeThread::Enter(int priority) {
  // Under a limit, a locked process fails in the first allocation beyond it, in the middle of a capture.
  rlimit limit{};
  if (getrlimit(RLIMIT_MEMLOCK, &limit) != 0 || limit.rlim_cur != RLIM_INFINITY)
    return Status::Failed("real time: the limit on locked memory is " + std::to_string(limit.rlim_cur / 1024) +
                          " KiB; set LimitMEMLOCK=infinity in the service (or `ulimit -l unlimited`)");
  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0)
    return Status::Failed(std::string("real time: memory cannot be locked: ") + std::strerror(errno));
  const sched_param parameters{.sched_priority = priority};
  if (sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &parameters) != 0) {
    const std::string cause = std::strerror(errno);
    munlockall();
    return Status::Failed("real time: SCHED_FIFO of priority " + std::to_string(priority) + ": " + cause +
                          "; set LimitRTPRIO=" + std::to_string(priority + 1) +
                          " or more in the service (or `ulimit -r`): the light's guard needs a higher priority");
  }
  return std::unique_ptr<RealtimeThread>(new RealtimeThread);
}

RealtimeThread::~RealtimeThread() {
  const sched_param parameters{};
  sched_setscheduler(0, SCHED_OTHER, &parameters);
  munlockall();
}

}  // namespace stratalux::rig
