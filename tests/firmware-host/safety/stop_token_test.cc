// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/safety/stop_token.h"

#include <thread>

#include <gtest/gtest.h>
#include <poll.h>

namespace stratalux::rig {
namespace {

bool Readable(const StopToken& stop) {
  pollfd waiting{stop.fd(), POLLIN, 0};
  return poll(&waiting, 1, 0) == 1;
}

TEST(StopToken, TheFirstReasonStaysAndAnOperatorBehindItIsNotForgotten) {
  StopToken stop;
  stop.Request(StopReason::kDoorOpen);
  stop.Request(StopReason::kVisitorLeft);
  EXPECT_FALSE(stop.operator_asked());
  stop.Request(StopReason::kOperator);
  EXPECT_EQ(stop.reason(), StopReason::kDoorOpen);
  EXPECT_TRUE(stop.operator_asked());
  stop.Reset();
  EXPECT_EQ(stop.reason(), StopReason::kOperator) << "nobody answered it yet";
  EXPECT_TRUE(Readable(stop));
  stop.Reset();
  EXPECT_FALSE(stop.stopped() || stop.operator_asked() || Readable(stop));
  stop.Request(StopReason::kOperator);
  stop.Reset();
  EXPECT_FALSE(stop.stopped());
}

// Whoever resets for a door, again and again, and however the operator's one request falls between.
TEST(StopToken, NoResetSwallowsAnOperatorsRequest) {
  for (int round = 0; round < 2000; ++round) {
    StopToken stop;
    stop.Request(StopReason::kDoorOpen);
    std::thread asks([&] { stop.Request(StopReason::kOperator); });
    // Resets while the door is the reason, as who waits for START does.
    for (int i = 0; i < 3 && !stop.operator_asked(); ++i) {
      if (stop.reason() == StopReason::kDoorOpen) stop.Reset();
      if (i < 2) stop.Request(StopReason::kDoorOpen);
    }
    asks.join();
    if (stop.reason() == StopReason::kDoorOpen) stop.Reset();
    EXPECT_EQ(stop.reason(), StopReason::kOperator);
    EXPECT_TRUE(Readable(stop));
  }
}

}  // namespace
}  // namespace stratalux::rig
