// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/pictures.h"

#include <cmath>
#include <cstdint>
#include <limits>

#include <gtest/gtest.h>

namespace stratalux::fit {
namespace {

const float kNan = std::numeric_limits<float>::quiet_NaN();

double Lightness(const Image<uint8_t>& rgb, int x) {
  auto linear = [&](int c) {
    const double s = rgb(x, 0, c) / 255.0;
    return s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4);
  };
  return 0.2126 * linear(0) + 0.7152 * linear(1) + 0.0722 * linear(2);
}

TEST(ToSrgb, FollowsTheStandardCurve) {
  // IEC 61966-2-1: byte 128 stands for 0.21586 linear; 0.0031308 is the end of the straight part (12.92 times).
  Image<float> linear(6, 1);
  const float values[6] = {0.0F, 1.0F, 0.21586F, 0.0031308F, 2.0F, -1.0F};
  for (int x = 0; x < 6; ++x) linear(x, 0) = values[x];
  const auto bytes = ToSrgb(linear, 1.0);
  const int expected[6] = {0, 255, 128, 10, 255, 0};
  for (int x = 0; x < 6; ++x) EXPECT_EQ(bytes(x, 0), expected[x]) << values[x];
}

TEST(ToSrgb, APixelWithoutOneColourIsBlack) {
  Image<float> linear(2, 1, 3, 0.5F);
  linear(0, 0, 2) = kNan;
  const auto bytes = ToSrgb(linear, 1.0);
  for (int c = 0; c < 3; ++c) {
    EXPECT_EQ(bytes(0, 0, c), 0) << c;
    EXPECT_GT(bytes(1, 0, c), 0) << c;
  }
}

TEST(ToSrgb, DependsOnTheRatioToWhiteAlone) {
  Image<float> one(50, 1), many(50, 1);
  for (int x = 0; x < 50; ++x) {
    one(x, 0) = static_cast<float>(x) / 32.0F;
    many(x, 0) = 4096.0F * one(x, 0);
  }
  const auto a = ToSrgb(one, 1.0), b = ToSrgb(many, 4096.0);
  EXPECT_TRUE(std::equal(a.pixels().begin(), a.pixels().end(), b.pixels().begin()));
}

TEST(ToSrgb, ShowsNoDataAndNoWhiteAsBlack) {
  EXPECT_EQ(ToSrgb(Image<float>(1, 1, 1, kNan), 1.0)(0, 0), 0);
  EXPECT_EQ(ToSrgb(Image<float>(1, 1, 1, 3.0F), 0.0)(0, 0), 0);
}

TEST(ToColourScale, GrowsLighterWithTheValue) {
  Image<float> map(200, 1);
  for (int x = 0; x < 200; ++x) map(x, 0) = 600.0F + static_cast<float>(x);
  const auto rgb = ToColourScale(map, 600.0, 799.0);
  for (int x = 1; x < 200; ++x) EXPECT_GE(Lightness(rgb, x), Lightness(rgb, x - 1) - 1e-3) << x;
  EXPECT_GT(Lightness(rgb, 199), 10 * Lightness(rgb, 0));
}

TEST(ToColourScale, HoldsItsEndsAndMarksNoData) {
  Image<float> map(5, 1);
  const float values[5] = {-9.0F, 0.0F, 1.0F, 9.0F, kNan};
  for (int x = 0; x < 5; ++x) map(x, 0) = values[x];
  const auto rgb = ToColourScale(map, 0.0, 1.0);
  for (int c = 0; c < 3; ++c) {
    EXPECT_EQ(rgb(0, 0, c), rgb(1, 0, c));
    EXPECT_EQ(rgb(3, 0, c), rgb(2, 0, c));
    EXPECT_EQ(rgb(4, 0, c), 40);
  }
}

TEST(NormalColours, PointsRightUpAndTowardsTheViewer) {
  Image<float> normals(4, 1, 3);
  const float values[4][3] = {{1, 0, 0}, {0, -1, 0}, {0, 0, -1}, {kNan, kNan, kNan}};
  for (int x = 0; x < 4; ++x)
    for (int c = 0; c < 3; ++c) normals(x, 0, c) = values[x][c];
  const auto rgb = NormalColours(normals);
  for (int x = 0; x < 3; ++x)
    for (int c = 0; c < 3; ++c) EXPECT_EQ(rgb(x, 0, c), c == x ? 255 : 128) << x << c;
  EXPECT_EQ(rgb(3, 0, 0), 40);
}

TEST(Percentile, OrdersTheFiniteValues) {
  Image<float> map(101, 1);
  for (int x = 0; x < 100; ++x) map(x, 0) = static_cast<float>((x * 37) % 100);
  map(100, 0) = kNan;
  EXPECT_EQ(Percentile(map, 0.0), 0.0);
  EXPECT_EQ(Percentile(map, 0.5), 50.0);
  EXPECT_EQ(Percentile(map, 1.0), 99.0);
  EXPECT_EQ(Percentile(Image<float>(3, 1, 1, kNan), 0.5), 0.0);
}

}  // namespace
}  // namespace stratalux::fit
