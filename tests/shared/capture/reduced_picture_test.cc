// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/reduced_picture.h"

#include <gtest/gtest.h>

namespace stratalux {
namespace {

TEST(ReducedPicture, IsTheMeanOfEachColourInSrgb) {
  FrameRecord record;
  record.format = PixelFormat::kMono12;
  record.cfa = Cfa::kRggb;
  Image<uint16_t> frame(8, 8);
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 8; ++x)
      frame(x, y) = CfaColour(record.cfa, x, y) == 0 ? 4095 : CfaColour(record.cfa, x, y) == 1 ? 877 : 0;
  const auto picture = ReducedPicture(record, frame.view(), 2);
  ASSERT_EQ(picture.width(), 2);
  ASSERT_EQ(picture.channels(), 3);
  EXPECT_EQ(picture(1, 1, 0), 255);
  EXPECT_EQ(picture(1, 1, 1), 128);  // half of sRGB is 0.21404 linear; this is 0.21416
  EXPECT_EQ(picture(1, 1, 2), 0);
  record.cfa = Cfa::kMono;
  EXPECT_EQ(ReducedPicture(record, frame.view(), 8).channels(), 1);
}

}  // namespace
}  // namespace stratalux
