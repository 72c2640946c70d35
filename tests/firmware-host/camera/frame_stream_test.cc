// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/camera/frame_stream.h"

#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

TEST(FrameStream, NumbersPassTheWrapWithoutAGap) {
  FrameStream stream;
  EXPECT_EQ(stream.Number(0xfffffffe), 0xfffffffeLL);
  EXPECT_EQ(stream.Number(0xffffffff), 0xffffffffLL);
  EXPECT_EQ(stream.Number(0), 0x100000000LL);
  EXPECT_EQ(stream.Number(1), 0x100000001LL);
}

TEST(FrameStream, ADroppedFrameLeavesItsGapEvenAtTheWrap) {
  FrameStream stream;
  EXPECT_EQ(stream.Number(0xffffffff), 0xffffffffLL);
  EXPECT_EQ(stream.Number(2), 0x100000002LL);
}

TEST(FrameStream, AFrameOfThePastHasANumberOfThePast) {
  FrameStream stream;
  EXPECT_EQ(stream.Number(10), 10);
  EXPECT_EQ(stream.Number(9), 9);
  EXPECT_EQ(stream.Number(11), 11);
}

TEST(FrameStream, AReopenedDeviceCountsOnWithAGap) {
  FrameStream stream;
  EXPECT_EQ(stream.Number(100), 100);
  stream.Reopened();
  EXPECT_EQ(stream.Number(0), 102) << "at least one frame is lost";
  EXPECT_EQ(stream.Number(1), 103);
}

TEST(FrameStream, StampsOfTheFutureOrThePastDoNotFit) {
  FrameStream stream;
  EXPECT_TRUE(stream.StampFits({1000}, {1001}));
  EXPECT_TRUE(stream.StampFits({2000}, {2001}));
  EXPECT_FALSE(stream.StampFits({9'223'372'020'000'000'000}, {2500})) << "shortly before a 64-bit wrap";
  EXPECT_FALSE(stream.StampFits({-5}, {2600})) << "after it";
  EXPECT_FALSE(stream.StampFits({1999}, {2700}));
  EXPECT_TRUE(stream.StampFits({2700 + 200'000'000}, {2700})) << "the end of a frame that still lies ahead";
  EXPECT_TRUE(stream.StampFits({2800 + 200'000'000}, {2800})) << "a stamp that did not fit is forgotten";
}

}  // namespace
}  // namespace stratalux::rig
