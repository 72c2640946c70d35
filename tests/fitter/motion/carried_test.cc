// SPDX-License-Identifier: Apache-2.0
#include "fitter/motion/carried.h"

#include <cmath>

#include <gmock/gmock.h>

namespace stratalux::fit {
namespace {

Image<float> Shifted(int width, int height, float dx, float dy) {
  Image<float> places(width, height, 2);
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) {
      places(i, j, 0) = static_cast<float>(i) + dx;
      places(i, j, 1) = static_cast<float>(j) + dy;
    }
  return places;
}

DecodedMap Slanted(int width, int height) {
  DecodedMap map{Image<float>(width, height), Image<float>(width, height), Image<float>(width, height, 1, 0.1F),
                 Image<float>(width, height, 1, 0.2F), Image<uint8_t>(width, height)};
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      map.column(x, y) = 0.8F * static_cast<float>(x) + 0.1F * static_cast<float>(y);
      map.row(x, y) = 0.7F * static_cast<float>(y);
    }
  return map;
}

TEST(Carried, CodesOfASlopeComeFromBetweenTheSites) {
  const DecodedMap map = Slanted(40, 30);
  const DecodedMap carried = Carried(map, Shifted(20, 15, 0.35F, -0.2F), Cfa::kRggb);  // sites: 0.7 and -0.4
  for (int y = 4; y < 26; ++y)
    for (int x = 4; x < 36; ++x) {
      EXPECT_NEAR(carried.column(x, y), map.column(x, y) + 0.8F * 0.7F - 0.1F * 0.4F, 1e-4F);
      EXPECT_NEAR(carried.row(x, y), map.row(x, y) - 0.7F * 0.4F, 1e-4F);
      EXPECT_NEAR(carried.column_sigma(x, y), 0.1F, 1e-6F);
      EXPECT_EQ(carried.reason(x, y), 0);
    }
}

TEST(Carried, NoCodeIsMadeOfTwoSurfacesOrOfWhatWasNotDecoded) {
  DecodedMap map = Slanted(40, 30);
  for (int y = 0; y < 30; ++y)
    for (int x = 20; x < 40; ++x) map.column(x, y) += 50.0F;
  map.reason(10, 10) = static_cast<uint8_t>(DecodeReason::kSaturated);
  map.column(10, 10) = std::nanf("");
  const DecodedMap carried = Carried(map, Shifted(20, 15, 0.2F, 0.0F), Cfa::kRggb);
  for (int x = 15; x < 25; ++x) {
    const float column = carried.column(x, 20), front = 0.8F * static_cast<float>(x) + 2.0F;
    EXPECT_TRUE(std::abs(column - front) < 1.0F || std::abs(column - front - 50.0F) < 1.0F) << x << ": " << column;
  }
  EXPECT_EQ(carried.reason(10, 10), static_cast<uint8_t>(DecodeReason::kSaturated));
  EXPECT_TRUE(std::isfinite(carried.column(9, 10))) << "its nearest site is its own";
  EXPECT_EQ(carried.reason(39, 5), static_cast<uint8_t>(DecodeReason::kValid));
  const DecodedMap far = Carried(map, Shifted(20, 15, 30.0F, 0.0F), Cfa::kRggb);
  EXPECT_EQ(far.reason(5, 5), static_cast<uint8_t>(DecodeReason::kOutside));
  EXPECT_TRUE(std::isnan(far.column(5, 5)));
}

TEST(Carried, AnAxisThatWasNotCapturedStaysUnknown) {
  DecodedMap map = Slanted(20, 20);
  for (float& row : map.row.pixels()) row = std::nanf("");
  const DecodedMap carried = Carried(map, Shifted(10, 10, 0.25F, 0.25F), Cfa::kRggb);
  EXPECT_NEAR(carried.column(8, 8), 0.8F * 8.5F + 0.1F * 8.5F, 1e-4F);
  EXPECT_TRUE(std::isnan(carried.row(8, 8)));
}

TEST(Carried, LightOfQuadsThatAreNotValidIsNotMixedIn) {
  SeparationMap map{Image<float>(8, 8, 3, 2.0F), Image<float>(8, 8, 3, 3.0F), Image<float>(8, 8, 3, 0.1F),
                    Image<float>(8, 8, 3, 5.0F), Image<uint8_t>(8, 8)};
  for (int c = 0; c < 3; ++c) map.direct(4, 4, c) = std::nanf("");
  map.reason(4, 4) = static_cast<uint8_t>(SeparationReason::kSaturated);
  const SeparationMap carried = Carried(map, Shifted(8, 8, 0.3F, 0.0F));
  EXPECT_EQ(carried.direct(3, 4, 0), 2.0F);
  EXPECT_EQ(carried.reason(3, 4), 0);
  EXPECT_TRUE(std::isnan(carried.direct(4, 4, 0)));
  EXPECT_EQ(carried.reason(4, 4), static_cast<uint8_t>(SeparationReason::kSaturated));
}

TEST(Carried, ProfilesComeFromTheNearestOne) {
  Image<float> places = Shifted(8, 6, 1.4F, -0.6F);
  for (int k = 0; k < 2; ++k) places(0, 5, k) = std::nanf("");
  const auto which = CarriedProfiles(places, 1, 3);
  ASSERT_EQ(which.size(), 8U * 6U * 3U);
  EXPECT_EQ(which[(2 * 8 + 3) * 3 + 1], (1 * 8 + 4) * 3 + 1);
  EXPECT_EQ(which[0], -1) << "above the picture";
  EXPECT_EQ(which[(5 * 8 + 0) * 3], -1) << "from nowhere";
  const auto pooled = CarriedProfiles(Shifted(8, 6, 2.2F, 0.0F), 2, 1);
  ASSERT_EQ(pooled.size(), 4U * 3U);
  EXPECT_EQ(pooled[1 * 4 + 1], 1 * 4 + 2);
}

}  // namespace
}  // namespace stratalux::fit
