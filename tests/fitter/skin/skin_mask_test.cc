// SPDX-License-Identifier: Apache-2.0
// Whose majority is skin: maps of light made up, of one material and of two, with noise and with holes.
#include "fitter/skin/skin_mask.h"

#include <cmath>
#include <functional>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

struct Material {
  double reflectance, share;
};
constexpr Material kSkinOfAFace = {0.38, 0.8}, kHair = {0.012, 0.4}, kEyeWhite = {0.13, 0.25};

struct Spread {
  double log_reflectance = 0.12, share = 0.03;
};

SkinLight Blank(int width, int height, SkinReason reason) {
  SkinLight light{Image<float>(width, height, 3, std::nanf("")),
                  Image<float>(width, height, 3, std::nanf("")),
                  Image<uint8_t>(width, height, 1, static_cast<uint8_t>(reason)),
                  {}};
  light.counts[static_cast<size_t>(reason)] = int64_t{width} * height;
  return light;
}

void SetReason(SkinLight& light, int i, int j, SkinReason reason) {
  --light.counts[light.reason(i, j)];
  light.reason(i, j) = static_cast<uint8_t>(reason);
  ++light.counts[light.reason(i, j)];
}

// Green and blue go through less than red, as in skin.
void SetMaterial(SkinLight& light, int i, int j, const Material& material, const Spread& spread, Random& random) {
  SetReason(light, i, j, SkinReason::kMeasured);
  const double factor = std::exp(spread.log_reflectance * random.Normal()), more = spread.share * random.Normal();
  for (int c = 0; c < 3; ++c) {
    light.reflectance(i, j, c) = static_cast<float>(material.reflectance * factor / (1.0 + c));
    light.share(i, j, c) = static_cast<float>(std::clamp(material.share - 0.1 * c + more, 0.01, 0.99));
  }
}

constexpr int kFaceWidth = 80, kFaceHeight = 60;

using Layout = std::function<bool(int i, int j)>;
bool Nowhere(int /*i*/, int /*j*/) { return false; }
bool InPatch(int i, int j) { return i >= 10 && i < 34 && j >= 8 && j < 28; }

// `other` where `is_other`, skin elsewhere.
SkinLight Face(const Material& skin, const Material& other, const Layout& is_other, const Spread& spread = {},
               uint64_t seed = 5) {
  SkinLight light = Blank(kFaceWidth, kFaceHeight, SkinReason::kNoSurface);
  Random random(seed);
  for (int j = 0; j < kFaceHeight; ++j)
    for (int i = 0; i < kFaceWidth; ++i) SetMaterial(light, i, j, is_other(i, j) ? other : skin, spread, random);
  return light;
}

SkinMask Judge(const SkinLight& light, const SkinOptions& options = {}) {
  auto mask = JudgeSkin(light, options);
  EXPECT_TRUE(mask.ok()) << mask.status().message();
  return std::move(mask).value();
}

int64_t Wrong(const SkinMask& mask, const Layout& is_other) {
  int64_t wrong = 0;
  for (int j = 0; j < mask.skin.height(); ++j)
    for (int i = 0; i < mask.skin.width(); ++i)
      if (mask.reason(i, j) != static_cast<uint8_t>(SkinReason::kNoSurface))
        wrong += (mask.skin(i, j) == 0) != is_other(i, j) ? 1 : 0;
  return wrong;
}

TEST(JudgeSkin, AFaceOfNothingElseIsAllSkin) {
  const SkinMask mask = Judge(Face(kSkinOfAFace, kHair, Nowhere));
  EXPECT_TRUE(mask.told);
  EXPECT_EQ(Wrong(mask, Nowhere), 0);
  EXPECT_EQ(mask.skin_quads, kFaceWidth * kFaceHeight);
  EXPECT_EQ(mask.left_out(), 0);
  EXPECT_EQ(mask.colour, 0);
  EXPECT_NEAR(std::exp(mask.log_reflectance.centre), kSkinOfAFace.reflectance, 0.01);
  EXPECT_NEAR(mask.share.centre, kSkinOfAFace.share, 0.005);
}

TEST(JudgeSkin, TellsHairAndEyesFromSkin) {
  for (const Material& other : {kHair, kEyeWhite}) {
    const SkinMask mask = Judge(Face(kSkinOfAFace, other, InPatch));
    EXPECT_LE(Wrong(mask, InPatch), 2) << other.reflectance;
    EXPECT_GT(mask.probability(60, 40), 0.95F);
    EXPECT_LT(mask.probability(20, 20), 0.05F);
  }
}

// No colour and no brightness is written down anywhere: dark skin has a majority as light skin has one.
TEST(JudgeSkin, DarkSkinIsSkin) {
  const SkinMask mask = Judge(Face({0.06, 0.5}, {0.003, 0.15}, InPatch));
  EXPECT_LE(Wrong(mask, InPatch), 2);
}

TEST(JudgeSkin, HairOnTwoFifthsOfAFaceIsNotItsMajority) {
  const auto upper = [](int /*i*/, int j) { return j < 2 * kFaceHeight / 5; };
  EXPECT_LE(Wrong(Judge(Face(kSkinOfAFace, kHair, upper)), upper), 4);
}

// Lips and brown spots lie off the majority, not out of its reach.
TEST(JudgeSkin, LipsAreSkin) { EXPECT_EQ(Wrong(Judge(Face(kSkinOfAFace, {0.3, 0.68}, InPatch)), Nowhere), 0); }

TEST(JudgeSkin, NoiseAloneHasNoHair) {
  const SkinMask mask = Judge(Face(kSkinOfAFace, kHair, Nowhere, {1.5, 0.25}));
  EXPECT_TRUE(mask.told);
  EXPECT_GT(mask.log_reflectance.scale, 1.0);  // as noisy as it is
  EXPECT_GE(mask.skin_quads, 99 * kFaceWidth * kFaceHeight / 100);
}

TEST(JudgeSkin, WhatWasNotMeasuredFollowsItsNeighbours) {
  SkinLight light = Face(kSkinOfAFace, kHair, InPatch);
  for (const SkinReason reason : {SkinReason::kUnlit, SkinReason::kNotPositive})
    for (int k = 0; k < 3; ++k) {
      const int j = reason == SkinReason::kUnlit ? 15 : 20;
      for (const int i : {18 + k, 60 + k}) {
        SetReason(light, i, j, reason);
        light.reflectance(i, j, 0) = -1e9F;  // must not be read
      }
    }
  const SkinMask mask = Judge(light);
  EXPECT_LE(Wrong(mask, InPatch), 2);
  EXPECT_EQ(mask.counts[static_cast<size_t>(SkinReason::kUnlit)], 6);
  EXPECT_EQ(mask.counts[static_cast<size_t>(SkinReason::kNotPositive)], 6);
  EXPECT_EQ(mask.surface_quads(), kFaceWidth * kFaceHeight);
  for (const float p : mask.probability.pixels()) EXPECT_TRUE(p >= 0.0F && p <= 1.0F);
}

TEST(JudgeSkin, OffTheSurfaceThereIsNone) {
  SkinLight light = Face(kSkinOfAFace, kHair, InPatch);
  for (int j = 0; j < kFaceHeight; ++j) SetReason(light, 50, j, SkinReason::kNoSurface);
  const SkinMask mask = Judge(light);
  EXPECT_TRUE(std::isnan(mask.probability(50, 3)));
  EXPECT_EQ(mask.skin(50, 3), 0);
  EXPECT_EQ(mask.surface_quads(), (kFaceWidth - 1) * kFaceHeight);
}

TEST(JudgeSkin, WithoutAMajorityAllOfTheSurfaceIsSkin) {
  const SkinMask empty = Judge(Blank(kFaceWidth, kFaceHeight, SkinReason::kNoSurface));
  EXPECT_FALSE(empty.told);
  EXPECT_EQ(empty.skin_quads, 0);
  EXPECT_EQ(empty.surface_quads(), 0);
  const SkinMask unlit = Judge(Blank(kFaceWidth, kFaceHeight, SkinReason::kUnlit));
  EXPECT_FALSE(unlit.told);
  EXPECT_EQ(unlit.skin_quads, kFaceWidth * kFaceHeight);
  // Images too small to have one.
  for (const int width : {1, 3}) {
    SkinLight tiny = Blank(width, 2, SkinReason::kNoSurface);
    Random random(1);
    SetMaterial(tiny, 0, 0, kSkinOfAFace, {}, random);
    SetMaterial(tiny, width - 1, 1, kHair, {}, random);
    const SkinMask mask = Judge(tiny);
    EXPECT_FALSE(mask.told);
    EXPECT_EQ(mask.skin_quads, 2);
  }
  EXPECT_FALSE(Judge(SkinLight{}).told);
}

TEST(JudgeSkin, AMonoCameraTellsAsWell) {
  const SkinLight colours = Face(kSkinOfAFace, kHair, InPatch);
  SkinLight mono = Blank(kFaceWidth, kFaceHeight, SkinReason::kMeasured);
  mono.reflectance = mono.share = Image<float>(kFaceWidth, kFaceHeight);
  for (int j = 0; j < kFaceHeight; ++j)
    for (int i = 0; i < kFaceWidth; ++i) {
      mono.reflectance(i, j) = colours.reflectance(i, j, 0);
      mono.share(i, j) = colours.share(i, j, 0);
    }
  EXPECT_EQ(Judge(mono).skin_quads, Judge(colours).skin_quads);
}

// The ablations: each of the three tells something that the others do not.
TEST(JudgeSkin, NeedsTheShareForWhatReflectsAsMuchGlobalLight) {
  const SkinLight light = Face(kSkinOfAFace, {0.2, 0.1}, InPatch);
  EXPECT_LE(Wrong(Judge(light), InPatch), 2);
  EXPECT_GT(Wrong(Judge(light, {.by_share = false}), InPatch), 100);
}

TEST(JudgeSkin, NeedsTheReflectanceForADarkPit) {
  const SkinLight light = Face(kSkinOfAFace, {0.01, 0.75}, InPatch);
  EXPECT_LE(Wrong(Judge(light), InPatch), 2);
  EXPECT_GT(Wrong(Judge(light, {.by_reflectance = false}), InPatch), 100);
}

TEST(JudgeSkin, NeedsTheNeighboursInNoise) {
  const SkinLight light = Face(kSkinOfAFace, {0.05, 0.45}, InPatch, {0.5, 0.2});
  const int64_t with = Wrong(Judge(light), InPatch), without = Wrong(Judge(light, {.coupling = 0.0}), InPatch);
  EXPECT_LT(2 * with, without);
}

TEST(JudgeSkin, RefusesOptionsWithoutMeaning) {
  const SkinLight light = Face(kSkinOfAFace, kHair, Nowhere);
  for (const SkinOptions& options : {SkinOptions{.least_log_scale = 0.0},
                                     {.least_share_scale = -1.0},
                                     {.freedom = 0.5},
                                     {.coupling = -1.0},
                                     {.coupling = std::nan("")},
                                     {.least_quads = 0}})
    EXPECT_EQ(JudgeSkin(light, options).status().code(), StatusCode::kUsage);
}

TEST(AllSkin, IsTheSurface) {
  Image<uint8_t> surface(4, 3, 1, 1);
  surface(2, 1) = 0;
  const SkinMask mask = AllSkin(surface);
  EXPECT_FALSE(mask.told);
  EXPECT_EQ(mask.skin_quads, 11);
  EXPECT_EQ(mask.left_out(), 0);
  EXPECT_TRUE(std::isnan(mask.probability(2, 1)));
  EXPECT_EQ(AllSkin(Image<uint8_t>{}).surface_quads(), 0);
}

}  // namespace
}  // namespace stratalux::fit
