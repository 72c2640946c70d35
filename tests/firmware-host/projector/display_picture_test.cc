// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/display_picture.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

const std::vector<DisplayMode> kModes = {
    {1920, 1080, 60.0}, {1024, 768, 60.004}, {1024, 768, 75.03}, {1024, 768, 70.07}, {0, 768, 120.0}};

TEST(PickMode, TakesTheFastestOfTheSizeUnlessARateIsNamed) {
  EXPECT_EQ(PickMode(kModes, 1024, 768, 0.0), 2U);
  EXPECT_EQ(PickMode(kModes, 1024, 768, 60.0), 1U);
  EXPECT_EQ(PickMode(kModes, 1920, 1080, 0.0), 0U);
}

TEST(PickMode, NeverSettlesForAnotherSizeOrRate) {
  EXPECT_EQ(PickMode(kModes, 1280, 720, 0.0), std::nullopt);
  EXPECT_EQ(PickMode(kModes, 1024, 768, 72.0), std::nullopt);
  EXPECT_EQ(PickMode({}, 1024, 768, 0.0), std::nullopt);
}

Image<uint32_t> Drawn(const Pattern& pattern, double gamma, int width, int height, int stride) {
  Image<uint32_t> pixels(stride, height, 1, 0xdeadbeef);
  DrawPattern(pattern, gamma, width, pixels);
  return pixels;
}

TEST(DrawPattern, SendsEachPixelTheIntensityOfThePattern) {
  const Pattern patterns[] = {
      {},
      {.kind = PatternKind::kWhite},
      {.kind = PatternKind::kGray, .bit = 3, .bits = 6},
      {.kind = PatternKind::kGray, .axis = PatternAxis::kRows, .bit = 2, .bits = 5, .inverse = true},
      {.kind = PatternKind::kSinusoid, .period = 16, .shift = 1, .shifts = 4},
      {.kind = PatternKind::kSinusoid, .axis = PatternAxis::kRows, .period = 8, .shift = 3, .shifts = 4},
      {.kind = PatternKind::kCheckerboard, .period = 8, .shift = 1, .shifts = 2},
      {.kind = PatternKind::kSpots, .period = 12, .width = 3},
  };
  for (const Pattern& pattern : patterns) {
    const Image<uint32_t> pixels = Drawn(pattern, 1.0, 40, 30, 48);
    for (int y = 0; y < 30; ++y)
      for (int x = 0; x < 48; ++x) {
        if (x >= 40) {
          EXPECT_EQ(pixels(x, y), 0xdeadbeef) << "drawn beside the picture";
          continue;
        }
        const uint32_t pixel = pixels(x, y);
        ASSERT_EQ(pixel >> 16, pixel & 0xff) << "not grey";
        ASSERT_EQ((pixel >> 8) & 0xff, pixel & 0xff) << "not grey";
        ASSERT_NEAR(pixel & 0xff, 255.0 * pattern.Intensity(x, y), 0.5001)
            << pattern.ToString() << " at " << x << ", " << y;
      }
  }
}

TEST(DrawPattern, UndoesTheDisplaysGamma) {
  const Pattern sinusoid = {.kind = PatternKind::kSinusoid, .period = 32, .shifts = 4};
  const Image<uint32_t> pixels = Drawn(sinusoid, 2.2, 32, 1, 32);
  for (int x = 0; x < 32; ++x) {
    const double light = std::pow((pixels(x, 0) & 0xff) / 255.0, 2.2);
    // Half a level of 255, where the curve is steepest.
    EXPECT_NEAR(light, sinusoid.Intensity(x, 0), 2.2 / 255.0 / 2 * 1.001);
  }
}

}  // namespace
}  // namespace stratalux::rig
