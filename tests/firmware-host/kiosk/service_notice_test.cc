// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/service_notice.h"

#include <thread>

#include <gmock/gmock.h>

#include "tests/firmware-host/kiosk/notify_socket.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using namespace std::chrono_literals;

class ServiceNoticeTest : public ScratchFolderTest {};

TEST_F(ServiceNoticeTest, SaysEachStateOnceAndThatItIsAliveAtHalfTheWatchdogsTime) {
  NotifySocket systemd(folder_ / "notify", 200ms);
  ServiceNotice notice;
  notice.Ready();
  notice.State("idle");
  notice.State("idle");
  notice.State("capture");
  for (int i = 0; i < 100; ++i) notice.Alive();
  notice.Stopping();
  EXPECT_THAT(systemd.Take(), ElementsAre("READY=1", "STATUS=idle", "STATUS=capture", "WATCHDOG=1", "STOPPING=1"));
  std::this_thread::sleep_for(110ms);
  notice.Alive();
  EXPECT_THAT(systemd.Take(), ElementsAre("WATCHDOG=1"));
}

TEST_F(ServiceNoticeTest, NeverWaitsForWhoDoesNotReadAndSaysItLater) {
  NotifySocket systemd(folder_ / "notify", 2us);  // at every turn
  ServiceNotice notice;
  const auto begun = std::chrono::steady_clock::now();
  for (int i = 0; i < 5000; ++i) {
    notice.State("filled " + std::to_string(i));
    notice.Alive();
  }
  notice.Ready();
  notice.State("the last");
  EXPECT_LT(std::chrono::steady_clock::now() - begun, 5s) << "a sender that waits would wait for ever";
  const auto first = systemd.Take();
  EXPECT_FALSE(first.empty());
  EXPECT_LT(first.size(), 5000U) << "the socket was full, else the test shows nothing";
  notice.Alive();
  const auto later = systemd.Take();
  EXPECT_THAT(later, Contains("READY=1"));
  EXPECT_THAT(later, Contains("STATUS=the last"));
  EXPECT_THAT(later, Contains("WATCHDOG=1"));
}

TEST_F(ServiceNoticeTest, AnothersWatchdogIsNotFedAndNobodyIsNoError) {
  NotifySocket systemd(folder_ / "notify", 1ms);
  setenv("WATCHDOG_PID", "1", 1);
  ServiceNotice notice;
  notice.Alive();
  EXPECT_THAT(systemd.Take(), IsEmpty());
  for (const char* nobody : {"/nonexistent/socket", "relative", "@", "vsock:2:1", ""}) {
    setenv("NOTIFY_SOCKET", nobody, 1);
    ServiceNotice silent;
    silent.Ready();
    silent.Alive();
  }
}

}  // namespace
}  // namespace stratalux::rig
