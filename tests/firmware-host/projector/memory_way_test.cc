// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/memory_way.h"

#include <vector>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

using std::chrono::milliseconds;

Pattern Comb(int shift) { return {.kind = PatternKind::kComb, .period = 64, .width = 1, .shift = shift}; }

// 0 1 2 .. 9, with 3 4 again at the end.
std::vector<Pattern> Memory() {
  std::vector<Pattern> memory;
  for (int k = 0; k < 10; ++k) memory.push_back(Comb(k));
  for (const int k : {3, 4}) memory.push_back(Comb(k));
  return memory;
}

TEST(FindWay, TakesTheNearestPlaceForwardOrOverTheEndOrFromReset) {
  const std::vector<Pattern> memory = Memory(), there = {Comb(3), Comb(4)};
  const MemoryTiming around{milliseconds(1), std::nullopt};
  EXPECT_EQ(FindWay(memory, there, 1, around), (MemoryWay{WayStart::kHere, 2, 3}));
  EXPECT_EQ(FindWay(memory, there, 3, around), (MemoryWay{WayStart::kHere, 0, 3}));
  EXPECT_EQ(FindWay(memory, there, 4, around), (MemoryWay{WayStart::kHere, 6, 10}));
  EXPECT_EQ(FindWay(memory, there, 11, around), (MemoryWay{WayStart::kHere, 4, 3})) << "over the end";
  const MemoryTiming cheap{milliseconds(1), milliseconds(2)};
  EXPECT_EQ(FindWay(memory, there, 4, cheap), (MemoryWay{WayStart::kReset, 3, 3})) << "5 ms, not 6";
  const MemoryTiming dear{milliseconds(1), milliseconds(4)};
  EXPECT_EQ(FindWay(memory, there, 4, dear), (MemoryWay{WayStart::kHere, 6, 10})) << "6 ms, not 7";
}

TEST(FindWay, AnUnknownPlaceIsLeftByReset) {
  const std::vector<Pattern> memory = Memory(), there = {Comb(3), Comb(4)};
  EXPECT_EQ(FindWay(memory, there, std::nullopt, {milliseconds(1), milliseconds(500)}),
            (MemoryWay{WayStart::kReset, 3, 3}));
  EXPECT_FALSE(FindWay(memory, there, std::nullopt, {milliseconds(1), std::nullopt}));
}

TEST(FindWay, WhatIsNotThereInARowHasNoWay) {
  const std::vector<Pattern> memory = Memory();
  for (const std::vector<Pattern>& other :
       {std::vector{Comb(10)}, std::vector{Comb(4), Comb(3)}, std::vector{Comb(4), Comb(0)}})
    EXPECT_FALSE(FindWay(memory, other, 0, {milliseconds(1), milliseconds(1)}));
}

// Random memories of few patterns, so that a sequence stands in many places.
TEST(FindWay, NoOtherWayIsShorterAndItsEndShowsTheSequence) {
  constexpr uint64_t kSeed = 11;
  for (uint64_t trial = 0; trial < 500; ++trial) {
    Random random(kSeed, trial);
    const auto draw = [&](int64_t n) { return static_cast<int64_t>(random.Uniform() * static_cast<double>(n)); };
    std::vector<Pattern> memory;
    for (int k = 0; k < 30; ++k) memory.push_back(Comb(static_cast<int>(draw(3))));
    const auto at = draw(28);
    const std::vector<Pattern> sequence(memory.begin() + at, memory.begin() + at + 1 + draw(2));
    const auto next = draw(30);
    const MemoryTiming timing{milliseconds(draw(3)), milliseconds(draw(20))};
    const auto way = FindWay(memory, sequence, next, timing);
    ASSERT_TRUE(way) << trial;
    const int64_t start = way->start == WayStart::kReset ? 0 : next;
    EXPECT_EQ((start + way->steps) % 30, way->target);
    for (int64_t place = 0; place + std::ssize(sequence) <= 30; ++place) {
      const bool holds = std::equal(sequence.begin(), sequence.end(), memory.begin() + place);
      if (place == way->target) {
        EXPECT_TRUE(holds) << trial;
      }
      if (!holds) continue;
      EXPECT_LE(TimeOf(*way, timing), ((place - next + 30) % 30) * timing.step) << trial;
      EXPECT_LE(TimeOf(*way, timing), *timing.reset + place * timing.step) << trial;
    }
  }
}

}  // namespace
}  // namespace stratalux::rig
