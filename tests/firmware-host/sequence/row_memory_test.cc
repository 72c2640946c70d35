// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/row_memory.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

Image<uint16_t> Noisy(uint64_t seed, double level, double deviation) {
  Random random(seed);
  Image<uint16_t> frame(120, 40);
  for (uint16_t& v : frame.pixels()) v = static_cast<uint16_t>(level + deviation * random.Normal() + 0.5);
  return frame;
}

TEST(RowMemory, NoiseNeverRepeats) {
  RowMemory memory;
  for (uint64_t seed = 0; seed < 200; ++seed) EXPECT_EQ(memory.ShareRepeated(Noisy(seed, 64.0, 1.0)), 0.0) << seed;
}

TEST(RowMemory, AFrozenFrameRepeatsWhollyEvenLater) {
  RowMemory memory;
  const Image<uint16_t> frozen = Noisy(1, 500.0, 5.0);
  memory.ShareRepeated(frozen);
  for (uint64_t seed = 2; seed < 17; ++seed) memory.ShareRepeated(Noisy(seed, 500.0, 5.0));
  EXPECT_EQ(memory.ShareRepeated(frozen), 1.0);
}

TEST(RowMemory, ATornFrameRepeatsItsLowerRows) {
  RowMemory memory;
  const Image<uint16_t> before = Noisy(1, 500.0, 5.0);
  Image<uint16_t> torn = Noisy(2, 500.0, 5.0);
  std::copy(before.row(30), before.row(0) + before.size(), torn.row(30));
  memory.ShareRepeated(before);
  EXPECT_DOUBLE_EQ(memory.ShareRepeated(torn), 0.25);
}

TEST(RowMemory, RowsOfOneValueSayNothing) {
  RowMemory memory;
  memory.ShareRepeated(Image<uint16_t>(120, 40, 1, 4095));
  EXPECT_EQ(memory.ShareRepeated(Image<uint16_t>(120, 40, 1, 4095)), 0.0);
}

TEST(RowMemory, TheEdgeOfASaturatedTargetSaysNothing) {
  RowMemory memory;
  Image<uint16_t> frame(120, 40, 1, 4095);
  for (int y = 0; y < frame.height(); ++y) frame(0, y) = 64;  // beside the target, where noise is a few values wide
  memory.ShareRepeated(frame);
  EXPECT_EQ(memory.ShareRepeated(frame), 0.0);
}

}  // namespace
}  // namespace stratalux::rig
