// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/realtime.h"

#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/resource.h>

namespace stratalux::rig {
namespace {

using ::testing::AnyOf;
using ::testing::HasSubstr;

TEST(RealtimeThread, RunsTheThreadUnderFifoOrSaysWhatIsMissing) {
  {
    const auto realtime = RealtimeThread::Enter(10);
    if (realtime.ok()) {
      EXPECT_EQ(sched_getscheduler(0) & ~SCHED_RESET_ON_FORK, SCHED_FIFO);
      int other = SCHED_FIFO;
      std::thread([&] { other = sched_getscheduler(0) & ~SCHED_RESET_ON_FORK; }).join();
      EXPECT_EQ(other, SCHED_OTHER);
    } else {
      EXPECT_THAT(realtime.status().message(), AnyOf(HasSubstr("LimitRTPRIO=10"), HasSubstr("LimitMEMLOCK=infinity"),
                                                     HasSubstr("memory cannot be locked")));
    }
  }
  EXPECT_EQ(sched_getscheduler(0) & ~SCHED_RESET_ON_FORK, SCHED_OTHER);
}

TEST(RealtimeThread, RefusesALimitOnLockedMemory) {
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_MEMLOCK, &before), 0);
  const rlimit small{.rlim_cur = 64 << 10, .rlim_max = before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_MEMLOCK, &small), 0);
  const auto realtime = RealtimeThread::Enter(10);
  setrlimit(RLIMIT_MEMLOCK, &before);
  ASSERT_FALSE(realtime.ok());
  EXPECT_THAT(realtime.status().message(), HasSubstr("64 KiB; set LimitMEMLOCK=infinity"));
}

}  // namespace
}  // namespace stratalux::rig
