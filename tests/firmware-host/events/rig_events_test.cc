// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/events/rig_events.h"

#include <array>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include "shared/base/random.h"
#include "tests/firmware-host/events/counted_new.h"
#include "tests/support/sanitized.h"

namespace stratalux::rig {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using enum RigSignal;
using enum SignalLevel;

class RigEventsTest : public ::testing::Test {
 protected:
  [[nodiscard]] bool Readable() const {
    pollfd waiting{events_.fd(), POLLIN, 0};
    return poll(&waiting, 1, 0) == 1;
  }
  std::vector<std::string> Words() {
    std::vector<std::string> words;
    for (const RigEvent& event : events_.Take()) words.emplace_back(event.ToString());
    return words;
  }
  StopToken stop_;
  RigEvents events_{stop_};
};

TEST_F(RigEventsTest, TheDescriptorIsReadableUntilEverythingIsTaken) {
  EXPECT_FALSE(Readable());
  EXPECT_THAT(events_.Take(), IsEmpty());
  events_.Tell(kDoor, kActive, {20});
  events_.PressStart({30});
  events_.Tell(kEmergencyStop, kActive, {10});
  EXPECT_TRUE(Readable());
  EXPECT_THAT(events_.Take(), ElementsAre(RigEvent{kEmergencyStop, kActive, {10}}, RigEvent{kDoor, kActive, {20}},
                                          RigEvent{kStart, kActive, {30}}))
      << "by time";
  EXPECT_FALSE(Readable());
  EXPECT_TRUE(events_.IsActive(kDoor) && events_.IsActive(kEmergencyStop));
  EXPECT_FALSE(events_.IsActive(kCamera));
}

TEST_F(RigEventsTest, TheSameAgainIsNoEvent) {
  events_.Tell(kDoor, kRest, {1});
  EXPECT_FALSE(Readable());
  for (int i = 0; i < 3; ++i) events_.Tell(kDoor, kActive, {2 + i});
  EXPECT_THAT(Words(), ElementsAre("door open"));
  EXPECT_EQ(events_.merged(), 0);
}

TEST_F(RigEventsTest, AMomentIsToldAlsoWhenItIsOver) {
  events_.TellMoment(kEmergencyStop, {5});
  EXPECT_FALSE(events_.IsActive(kEmergencyStop));
  EXPECT_THAT(Words(), ElementsAre("E-STOP pressed", "E-STOP released"));
}

// Nobody reads for a million edges: what waits stays bounded, the last level is right, what was open is told.
TEST_F(RigEventsTest, NothingOverflowsHoweverLongNobodyReads) {
  Random random(3);
  std::array<bool, kRigSignals> known{};
  int64_t edges = 0, taken = 0;
  for (int round = 0; round < 1000; ++round) {
    std::array<bool, kRigSignals> was = known;
    for (int i = 0; i < 1000; ++i) {
      const auto signal = static_cast<RigSignal>(random.Uniform(1, kRigSignals));
      bool& now = known[static_cast<size_t>(signal)];
      now = !now;
      events_.Tell(signal, now ? kActive : kRest, {++edges});
    }
    const std::vector<RigEvent> events = events_.Take();
    EXPECT_LE(events.size(), 2U * (kRigSignals - 1));
    taken += static_cast<int64_t>(events.size());
    std::array<bool, kRigSignals> told_active{};
    for (const RigEvent& event : events) {
      bool& level = was[static_cast<size_t>(event.signal)];
      EXPECT_NE(level, event.level == kActive) << "an event that changes nothing";
      level = event.level == kActive;
      told_active[static_cast<size_t>(event.signal)] |= level;
    }
    EXPECT_EQ(was, known) << "the last event says how it is";
    for (int s = 1; s < kRigSignals; ++s) EXPECT_TRUE(told_active[s] || !known[s]);
  }
  EXPECT_EQ(events_.merged(), edges - taken);
}

TEST_F(RigEventsTest, PressesThatNobodyReadAreOne) {
  for (int i = 0; i < 5; ++i) events_.PressStart({10 + i});
  EXPECT_THAT(events_.Take(), ElementsAre(RigEvent{kStart, kActive, {10}}));
  EXPECT_EQ(events_.merged(), 4);
  EXPECT_THAT(events_.Take(), IsEmpty());
}

TEST_F(RigEventsTest, StartOfAnOccupiedRigIsCountedAndGone) {
  events_.PressStart({1});  // a second press of who is seated now
  {
    const RigEvents::Occupied occupied(events_);
    EXPECT_EQ(occupied.dropped(), 1);
    for (int i = 0; i < 3; ++i) events_.PressStart({2 + i});
    EXPECT_EQ(occupied.dropped(), 4);
    events_.Tell(kDoor, kActive, {9});
    EXPECT_THAT(Words(), ElementsAre("door open")) << "everything else is told";
  }
  EXPECT_THAT(Words(), IsEmpty()) << "queued for the next visitor";
  EXPECT_EQ(events_.dropped_starts(), 4);
  events_.PressStart({20});
  EXPECT_THAT(Words(), ElementsAre("START pressed"));
}

TEST_F(RigEventsTest, AnUnpluggedCameraStopsTheWorkAndNothingElseDoes) {
  for (const RigSignal signal : {kDoor, kEmergencyStop, kLines}) events_.Tell(signal, kActive, {1});
  EXPECT_FALSE(stop_.stopped()) << "those are the guard's";
  events_.Tell(kCamera, kActive, {2});
  EXPECT_EQ(stop_.reason(), StopReason::kCameraGone);
  stop_.Reset();
  events_.Tell(kCamera, kRest, {3});
  EXPECT_FALSE(stop_.stopped());
}

TEST_F(RigEventsTest, TellingAllocatesNothing) {
  if (kUnderAddressSanitizer) GTEST_SKIP() << "AddressSanitizer counts allocations for itself";
  const int64_t before = AllocationsOfThisThread();
  for (int i = 0; i < 100; ++i) {
    events_.Tell(kDoor, i % 2 == 0 ? kActive : kRest, {i});
    events_.TellMoment(kEmergencyStop, {i});
    events_.PressStart({i});
  }
  EXPECT_EQ(AllocationsOfThisThread(), before);
  EXPECT_EQ(events_.Take().size(), 5U);
  EXPECT_GT(AllocationsOfThisThread(), before) << "or nothing counts";
}

// Four threads tell, one reads by the descriptor alone: no press is lost or told twice, and the last level arrives.
TEST_F(RigEventsTest, ManyTellAndOneReadsByTheDescriptor) {
  constexpr int kRounds = 20000;
  std::atomic<bool> done = false;
  std::vector<std::thread> world;
  for (const RigSignal signal : {kDoor, kEmergencyStop, kLines})
    world.emplace_back([this, signal] {
      for (int i = 0; i <= kRounds; ++i) events_.Tell(signal, i % 2 == 0 ? kActive : kRest, MonotonicNow());
    });
  world.emplace_back([this] {
    for (int i = 0; i < kRounds; ++i) events_.PressStart(MonotonicNow());
  });
  std::thread waits([&] {
    for (std::thread& thread : world) thread.join();
    done.store(true);
  });
  std::array<bool, kRigSignals> level{};
  int64_t told = 0, wrong = 0;
  for (bool last = false; !last;) {
    last = done.load();
    pollfd waiting{events_.fd(), POLLIN, 0};
    if (poll(&waiting, 1, last ? 0 : 50) == 0) continue;
    for (const RigEvent& event : events_.Take()) {
      ++told;
      bool& now = level[static_cast<size_t>(event.signal)];
      if (event.signal != kStart) wrong += now == (event.level == kActive);
      now = event.level == kActive;
    }
  }
  waits.join();
  EXPECT_EQ(wrong, 0);
  for (const RigSignal signal : {kDoor, kEmergencyStop, kLines}) EXPECT_TRUE(level[static_cast<size_t>(signal)]);
  EXPECT_EQ(told + events_.merged(), 3 * (kRounds + 1) + kRounds);
}

}  // namespace
}  // namespace stratalux::rig
