// SPDX-License-Identifier: Apache-2.0
// A pattern's light against what it is by definition: boxes under a Gaussian, averaged over a parallelogram.
#include "firmware-host/simulated/projected_light.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

double Phi(double x) { return 0.5 * std::erfc(-x / std::numbers::sqrt2); }

// Light at `x` of columns first .. last under a Gaussian.
double OfColumns(double x, int first, int last, double sigma) {
  return Phi((last + 0.5 - x) / sigma) - Phi((first - 0.5 - x) / sigma);
}

std::vector<float> Columns(int count, int first, int last) {
  std::vector<float> profile(count, 0.0F);
  std::fill(profile.begin() + first, profile.begin() + last + 1, 1.0F);
  return profile;
}

TEST(LightAlongAxis, IsBoxesUnderAGaussianAveragedOverTwoBoxes) {
  constexpr int kFirst = 20, kLast = 21, kPoints = 60;
  for (double sigma : {0.3, 0.5, 1.4}) {
    const LightAlongAxis light(Columns(64, kFirst, kLast), sigma);
    for (const auto& [a, b] : {std::pair{0.0, 0.0}, {0.45, 0.0}, {0.45, 0.2}, {0.1, 2.5}, {3.0, 3.0}})
      for (double x = 12.0; x < 30.0; x += 0.37) {
        double mean = 0.0;
        for (int j = 0; j < kPoints; ++j)
          for (int i = 0; i < kPoints; ++i)
            mean += OfColumns(x + ((2 * i + 1.0) / kPoints - 1.0) * a + ((2 * j + 1.0) / kPoints - 1.0) * b, kFirst,
                              kLast, sigma) /
                    (kPoints * kPoints);
        ASSERT_NEAR(light.Mean(static_cast<float>(x), static_cast<float>(a), static_cast<float>(b)), mean, 0.003)
            << x << " px, half-widths " << a << " and " << b << ", blur " << sigma;
      }
  }
}

TEST(LightAlongAxis, GoesOnBeyondThePicture) {
  const LightAlongAxis white(std::vector<float>(64, 1.0F), 0.5);
  for (float x : {-400.0F, -20.0F, -0.5F, 31.3F, 63.0F, 90.0F, 400.0F})
    for (float a : {0.0F, 0.4F, 30.0F}) EXPECT_NEAR(white.Mean(x, a, 0.3F), 1.0, 1e-5) << x << ", " << a;
}

TEST(LightAlongAxis, KeepsTheLightOfALine) {
  // However little of the picture a pixel sees: evenly spaced, pixels side by side share out all of it.
  const LightAlongAxis light(Columns(64, 30, 30), 0.5);
  double sum = 0.0;
  for (int i = 0; i < 640; ++i) sum += light.Mean(0.1F * static_cast<float>(i), 0.05F, 0.0F);
  EXPECT_NEAR(0.1 * sum, 1.0, 1e-4);
}

TEST(SharedOut, HasTheVarianceThatWasAskedFor) {
  for (double sigma : {0.2, 0.5, 0.8, 2.0}) {
    const std::vector<float> out = SharedOut(Columns(65, 32, 32), sigma);
    double sum = 0.0, variance = 0.0;
    for (int i = 0; i < 65; ++i) {
      sum += out[i];
      variance += double{out[i]} * (i - 32) * (i - 32);
    }
    EXPECT_NEAR(sum, 1.0, 1e-5);
    EXPECT_NEAR(variance, sigma * sigma, 1e-4 * std::max(1.0, sigma)) << sigma;
  }
  EXPECT_EQ(SharedOut(Columns(65, 32, 32), 0.0), Columns(65, 32, 32));
}

TEST(MeanLight, IsThatOfBothAxesWhereAPixelsSidesAreTheirs) {
  constexpr double kSigma = 0.5;
  Image<float> square(40, 30);
  for (int y = 10; y <= 17; ++y)
    for (int x = 20; x <= 27; ++x) square(x, y) = 1.0F;
  const BlurredBoxes boxes(kSigma);
  const LightAlongAxis columns(Columns(40, 20, 27), kSigma), rows(Columns(30, 10, 17), kSigma);
  for (float x = 16.0F; x < 32.0F; x += 0.71F)
    for (float y = 7.0F; y < 21.0F; y += 0.53F)
      EXPECT_NEAR(MeanLight(square, boxes, x, y, {1.2F, 0.0F, 0.0F, -0.8F}),
                  columns.Mean(x, 0.6F, 0.0F) * rows.Mean(y, 0.4F, 0.0F), 0.012)
          << x << ", " << y;
}

TEST(MeanLight, LeansAsThePixelDoes) {
  // A pixel that lies along a diagonal edge sees it, one that lies across sees half of it.
  Image<float> half(40, 40);
  for (int y = 0; y < 40; ++y)
    for (int x = 0; x < 40; ++x) half(x, y) = x > y ? 1.0F : x == y ? 0.5F : 0.0F;
  const BlurredBoxes boxes(0.5);
  const auto above = [&](float side) { return MeanLight(half, boxes, 20.9F, 19.1F, {side, side, 0.2F, -0.2F}); };
  const auto across = [&](float side) { return MeanLight(half, boxes, 20.9F, 19.1F, {side, -side, 0.2F, 0.2F}); };
  EXPECT_NEAR(above(6.0F), above(0.2F), 0.03);
  EXPECT_NEAR(above(0.2F), 1.0, 0.03);
  EXPECT_LT(across(6.0F), 0.75F);
}

}  // namespace
}  // namespace stratalux::rig
