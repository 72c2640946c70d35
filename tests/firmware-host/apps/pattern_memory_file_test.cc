// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/pattern_memory_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using ::testing::ElementsAre;

TEST(PatternMemoryFile, TheLeftmostPixelIsTheHighestBitAndRowsArePadded) {
  // Lines at columns 0-1 and 8-9 of 10: 11000000 11......
  const Pattern comb = {.kind = PatternKind::kComb, .period = 8, .width = 2, .shift = 0};
  EXPECT_THAT(PackPatterns({comb}, 1, 10, 2), ElementsAre(0xC0, 0xC0, 0xC0, 0xC0));
  EXPECT_THAT(PackPatterns({{.kind = PatternKind::kWhite}, {}}, 1, 10, 1), ElementsAre(0xFF, 0xC0, 0x00, 0x00));
}

TEST(PatternMemoryFile, PlanesOfGreyAddUpToTheLevels) {
  const Pattern sinusoid = {.kind = PatternKind::kSinusoid, .period = 8, .shift = 1, .shifts = 4};
  EXPECT_EQ(PlanesOf(sinusoid), 8);
  const std::vector<uint8_t> planes = PackPatterns({sinusoid}, 8, 16, 1);
  ASSERT_EQ(planes.size(), 8U * 2U);
  for (int x = 0; x < 16; ++x) {
    int level = 0;
    for (int plane = 0; plane < 8; ++plane)
      level = level << 1 | (planes[static_cast<size_t>(plane * 2 + x / 8)] >> (7 - x % 8) & 1);
    EXPECT_NEAR(level, 255.0 * sinusoid.Intensity(x, 0), 0.5 + 1e-4) << x;
  }
}

}  // namespace
}  // namespace stratalux::rig
