// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/card_figures.h"

#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

constexpr int kWidth = 320, kHeight = 240;

Image<uint16_t> Even(uint16_t dn) {
  Image<uint16_t> image(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) image(x, y) = dn;
  return image;
}

// L of `light(x, y)` over a black of 64 DN.
template <typename Light>
Image<uint16_t> White(const Light& light) {
  Image<uint16_t> image(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) image(x, y) = static_cast<uint16_t>(64 + light(x, y));
  return image;
}

TEST(CardFigures, OfAnEvenCardAreItsLevelAndOnes) {
  const auto figures = CardFiguresOf(Even(64), White([](int, int) { return 1000; }), Cfa::kMono);
  ASSERT_TRUE(figures);
  EXPECT_DOUBLE_EQ(figures->dark_dn, 64.0);
  EXPECT_DOUBLE_EQ(figures->level_dn, 1000.0);
  EXPECT_DOUBLE_EQ(figures->lit, 1.0);
  EXPECT_DOUBLE_EQ(figures->even, 1.0);
  EXPECT_FALSE(figures->red_green || figures->blue_green) << "a grey camera sees no colours";
}

TEST(CardFigures, OfAMosaicAreTheRatiosOfItsColoursWhateverItsOrder) {
  for (const Cfa cfa : {Cfa::kRggb, Cfa::kBggr, Cfa::kGrbg, Cfa::kGbrg}) {
    const auto figures = CardFiguresOf(Even(64), White([cfa](int x, int y) {
                                         constexpr int kLight[] = {600, 1000, 800};
                                         return kLight[CfaColour(cfa, x, y)];
                                       }),
                                       cfa);
    ASSERT_TRUE(figures);
    EXPECT_NEAR(figures->red_green.value(), 0.6, 1e-12);
    EXPECT_NEAR(figures->blue_green.value(), 0.8, 1e-12);
    EXPECT_NEAR(figures->even, 1.0, 1e-12) << "blocks hold whole tiles";
  }
}

TEST(CardFigures, OfACardThatFillsHalfOfThePictureAreOfTheCardAlone) {
  const auto figures =
      CardFiguresOf(Even(64), White([](int x, int) { return x < kWidth / 2 ? 1000 : 40; }), Cfa::kMono);
  ASSERT_TRUE(figures);
  EXPECT_DOUBLE_EQ(figures->lit, 0.5);
  EXPECT_DOUBLE_EQ(figures->level_dn, 1000.0);
}

// A ramp from 600 to 1000: the means of its darkest and brightest tenths.
TEST(CardFigures, AreUnevenByTheTenthsOfARamp) {
  const auto figures = CardFiguresOf(
      Even(64), White([](int x, int) { return static_cast<int>(600.0 + 400.0 * (x + 0.5) / kWidth); }), Cfa::kMono);
  ASSERT_TRUE(figures);
  EXPECT_NEAR(figures->even, 620.0 / 980.0, 0.01);
}

TEST(CardFigures, OfABrightSpotAreNotThoseOfTheSpot) {
  const auto figures =
      CardFiguresOf(Even(64), White([](int x, int y) { return x < 32 && y < 32 ? 3900 : 1000; }), Cfa::kMono);
  ASSERT_TRUE(figures);
  EXPECT_DOUBLE_EQ(figures->lit, 1.0);
}

TEST(CardFigures, AreNoneWithoutLightAndOfPicturesThatDoNotFit) {
  EXPECT_FALSE(CardFiguresOf(Even(64), Even(64), Cfa::kMono));
  EXPECT_FALSE(CardFiguresOf(Even(64), Even(60), Cfa::kMono));
  EXPECT_FALSE(CardFiguresOf(Image<uint16_t>(64, 64), Even(64), Cfa::kMono));
  EXPECT_FALSE(CardFiguresOf(Image<uint16_t>(32, 64), Image<uint16_t>(32, 64), Cfa::kMono));
}

}  // namespace
}  // namespace stratalux::rig
