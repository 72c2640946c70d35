// SPDX-License-Identifier: Apache-2.0
// The guard over scripted lines: whatever fails, hangs or dies, every ENABLE is written off and reads off, and nothing
// lights up later. How soon is the benchmark's matter; here it must happen within a time that no loaded machine misses.
#include "firmware-host/safety/light_guard.h"

#include <atomic>
#include <cstdlib>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "tests/firmware-host/safety/guarded_gpio.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;

constexpr auto kAtLast = 20s;

class LightGuardTest : public ::testing::Test {
 protected:
  void ExpectDark() { EXPECT_TRUE(GuardedGpio::DarkWithin(kAtLast)); }
  // Nothing lights up later, however it is asked for.
  void ExpectHeldDark() {
    ExpectDark();
    for (int i = 0; i < 20; ++i) {
      EXPECT_FALSE(rig_.guard->On(i % 2, kLongLease).ok());
      EXPECT_FALSE(GuardedGpio::Lit(0) || GuardedGpio::Lit(1));
    }
  }
  StopToken stop_;
  GuardedGpio rig_{stop_};
};

TEST_F(LightGuardTest, OpensDarkAndSwitchesEachLightByItsPolarity) {
  EXPECT_FALSE(GuardedGpio::Lit(0) || GuardedGpio::Lit(1));
  ASSERT_TRUE(rig_.guard->On(1, kLongLease).ok());
  EXPECT_TRUE(GuardedGpio::Lit(1) && !GuardedGpio::Lit(0));
  ASSERT_TRUE(rig_.guard->On(0, kLongLease).ok());
  ASSERT_TRUE(rig_.guard->Off(1).ok());
  EXPECT_TRUE(GuardedGpio::Lit(0) && !GuardedGpio::Lit(1));
  EXPECT_EQ(rig_.guard->On(2, kLongLease).code(), StatusCode::kUsage);
  rig_.guard.reset();
  EXPECT_FALSE(GuardedGpio::Lit(0)) << "the guard went and left light on";
}

TEST_F(LightGuardTest, TroubleOfAnotherLineKeepsNoLightOn) {
  ASSERT_TRUE(rig_.guard->On(0, kLongLease).ok());
  for (const ScriptedLine line : {kCamera, kTrigger0, kEnable1}) TheGpio().lines[line].refuse_writes.store(-1);
  EXPECT_FALSE(rig_.bank->TriggerCamera().ok());
  EXPECT_TRUE(rig_.guard->Off(0).ok());
  EXPECT_FALSE(GuardedGpio::Lit(0));
  for (const ScriptedLine line : {kCamera, kTrigger0}) TheGpio().lines[line].refuse_writes.store(0);
  EXPECT_TRUE(rig_.bank->TriggerCamera().ok()) << "one failed write is no lost chip";
}

TEST_F(LightGuardTest, ARefusedOffIsNamedAndTriedUntilItIsReadBack) {
  for (const bool reading : {false, true}) {
    ASSERT_TRUE(rig_.guard->On(0, kLongLease).ok());
    ScriptedGpio::Line& line = TheGpio().lines[kEnable0];
    (reading ? line.refuse_reads : line.refuse_writes).store(1000000);
    const Status off = rig_.guard->Off(0);
    EXPECT_FALSE(off.ok());
    EXPECT_THAT(off.message(), HasSubstr("ENABLE of projector 0 (LINE0"));
    EXPECT_THAT(off.message(), HasSubstr("Input/output error"));
    const int before = line.writes.load();
    (reading ? line.refuse_reads : line.refuse_writes).store(3);
    ExpectDark();
    EXPECT_GT(line.writes.load(), before - static_cast<int>(reading)) << "nobody tried again";
    while (line.refuse_reads.load() > 0) std::this_thread::sleep_for(1ms);
    EXPECT_TRUE(rig_.guard->Off(0).ok());
  }
}

TEST_F(LightGuardTest, EmergencyStopAndDoorTakeTheLightWithoutAnybodyAsking) {
  for (const bool held : {false, true})
    for (const ScriptedLine line : {kEmergencyStop, kDoor}) {
      ASSERT_TRUE(rig_.guard->On(0, kLongLease).ok() && rig_.guard->On(1, kLongLease).ok());
      TheGpio().Raise(line, held);
      ExpectHeldDark();
      EXPECT_EQ(stop_.reason(), line == kDoor ? StopReason::kDoorOpen : StopReason::kEmergencyStop);
      if (held) {
        EXPECT_THAT(rig_.guard->Reset().message(), HasSubstr("still active"));
      }
      TheGpio().lines[line].level.store(0);
      ASSERT_TRUE(rig_.guard->Reset().ok());
    }
  ASSERT_TRUE(rig_.guard->On(0, kLongLease).ok());
  EXPECT_TRUE(GuardedGpio::Lit(0));
}

TEST_F(LightGuardTest, AnInterlockThatCannotBeReadIsOpen) {
  ASSERT_TRUE(rig_.guard->On(0, kLongLease).ok());
  TheGpio().lines[kDoor].refuse_reads.store(-1);
  ExpectHeldDark();
  EXPECT_EQ(stop_.reason(), StopReason::kLinesGone);
  EXPECT_FALSE(rig_.guard->Reset().ok());
}

TEST_F(LightGuardTest, ALeaseThatNobodyRenewsEnds) {
  ASSERT_TRUE(rig_.guard->On(0, {.length = 30ms, .longest = 1h}).ok());
  ExpectHeldDark();
  EXPECT_EQ(stop_.reason(), StopReason::kLeaseExpired);
  EXPECT_FALSE(rig_.guard->Renew().ok());
}

TEST_F(LightGuardTest, NoRenewalOutlastsTheLongestStretch) {
  ASSERT_TRUE(rig_.guard->On(0, {.length = 1h, .longest = 100ms}).ok());
  while (rig_.guard->Renew().ok()) std::this_thread::sleep_for(1ms);
  ExpectHeldDark();
  EXPECT_EQ(stop_.reason(), StopReason::kOnTimeLimit);
}

TEST_F(LightGuardTest, ARenewedLeaseHolds) {
  ASSERT_TRUE(rig_.guard->On(0, {.length = 10s, .longest = 1h}).ok());
  for (int i = 0; i < 50; ++i) {
    ASSERT_TRUE(rig_.guard->Renew().ok());
    EXPECT_TRUE(GuardedGpio::Lit(0));
    std::this_thread::sleep_for(2ms);
  }
}

// A thread that switches as it likes, and the stop of another one, at 500 moments.
TEST_F(LightGuardTest, NothingLightsUpAfterAStop) {
  const char* seed = std::getenv("STRATALUX_SEED");
  Random random(seed != nullptr ? std::strtoull(seed, nullptr, 10) : 1, 0x5afe);
  for (int moment = 0; moment < 500; ++moment) {
    std::atomic<bool> ended = false;
    std::thread worker([&] {
      for (int i = 0; !ended.load(); ++i) {
        static_cast<void>(rig_.guard->On(i % 2, kLongLease));
        static_cast<void>(rig_.guard->Renew());
        if (i % 3 == 0) static_cast<void>(rig_.guard->Off(i % 2));
      }
    });
    std::this_thread::sleep_for(std::chrono::microseconds(static_cast<int>(random.Uniform(0.0, 2000.0))));
    const int cause = static_cast<int>(random.Uniform(0.0, 3.0));
    if (cause == 0) stop_.Request(StopReason::kVisitorLeft);
    if (cause == 1) TheGpio().Raise(kEmergencyStop, false);
    if (cause == 2) TheGpio().lines[kDoor].refuse_reads.store(1);
    const auto deadline = std::chrono::steady_clock::now() + kAtLast;
    while (!stop_.stopped() && std::chrono::steady_clock::now() < deadline) std::this_thread::sleep_for(100us);
    ASSERT_TRUE(stop_.stopped()) << "moment " << moment;
    // An 'on' that was under way may come and is taken back; then there is none.
    ASSERT_TRUE(GuardedGpio::DarkWithin(kAtLast));
    ended.store(true);
    worker.join();
    ASSERT_TRUE(GuardedGpio::DarkWithin(kAtLast));
    std::this_thread::sleep_for(200us);
    ASSERT_FALSE(GuardedGpio::Lit(0) || GuardedGpio::Lit(1)) << "moment " << moment << ", cause " << cause;
    ASSERT_TRUE(rig_.guard->Reset().ok());
  }
}

TEST(LightGuard, LightThatCannotBeSwitchedOffAtTheStartIsRefused) {
  StopToken stop;
  GuardedGpio rig(stop);
  rig.guard.reset();
  TheGpio().lines[kEnable0].refuse_writes.store(-1);
  const auto guard = LightGuard::Start({{rig.lights->enable(0)}}, nullptr, stop);
  EXPECT_THAT(guard.status().message(), HasSubstr("may still be lit"));
}

}  // namespace
}  // namespace stratalux::rig
