// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/preview/frame_figures.h"

#include <cmath>
#include <functional>

#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

Image<uint16_t> Frame(const std::function<double(int x, int y)>& value) {
  Image<uint16_t> frame(96, 64);
  for (int y = 0; y < frame.height(); ++y)
    for (int x = 0; x < frame.width(); ++x) frame(x, y) = static_cast<uint16_t>(std::lround(value(x, y)));
  return frame;
}

// An edge whose light rises over `width` pixels.
Image<uint16_t> Edge(double width, double light) {
  return Frame([=](int x, int) { return light * (1.5 + std::tanh((x - 48) / width)); });
}

TEST(FrameFigures, FocusIsTheVarianceOfTheLaplacianOverTheSquaredMean) {
  // Squares of one quad, m + a and m - a: the Laplacian is +-8 a, hence 64 a^2 / m^2.
  const auto chess = Frame([](int x, int y) { return (x / 2 + y / 2) % 2 == 0 ? 1100 : 900; });
  EXPECT_NEAR(FiguresOf(chess.view(), 4095).focus, 64.0 * 100 * 100 / (1000.0 * 1000.0), 1e-3);
}

TEST(FrameFigures, FocusIsZeroWhereNothingIsSharp) {
  EXPECT_EQ(FiguresOf(Frame([](int, int) { return 700; }).view(), 4095).focus, 0.0);
  EXPECT_NEAR(FiguresOf(Frame([](int x, int y) { return 20 * x + 10 * y; }).view(), 4095).focus, 0.0, 1e-9)
      << "a slope";
  EXPECT_EQ(FiguresOf(Frame([](int, int) { return 0; }).view(), 4095).focus, 0.0) << "black";
}

TEST(FrameFigures, FocusGrowsWithEveryStepOfSharpness) {
  double before = 0.0;
  for (const double width : {16.0, 8.0, 4.0, 2.0, 1.0}) {
    const double focus = FiguresOf(Edge(width, 1000).view(), 4095).focus;
    EXPECT_GT(focus, 1.5 * before) << "an edge of " << width << " px";
    before = focus;
  }
}

TEST(FrameFigures, FocusDoesNotDependOnTheExposure) {
  const double one = FiguresOf(Edge(3, 400).view(), 4095).focus, four = FiguresOf(Edge(3, 1600).view(), 4095).focus;
  EXPECT_NEAR(four / one, 1.0, 0.01);
}

TEST(FrameFigures, FocusLooksAtTheMiddle) {
  const auto corner = Frame([](int x, int y) { return x < 20 && y < 14 && (x / 2) % 2 == 0 ? 2000 : 500; });
  EXPECT_EQ(FiguresOf(corner.view(), 4095).focus, 0.0);
}

TEST(FrameFigures, LevelsAreSharesOfTheSaturation) {
  // 60 % at 1000, 38 % at 2000, 2 % at 4000 and more.
  const auto frame = Frame([](int x, int y) {
    const int i = (y * 96 + x) % 100;
    return i < 60 ? 1000 : i < 98 ? 2000 : 4000 + i % 2;
  });
  const FrameFigures figures = FiguresOf(frame.view(), 4000);
  EXPECT_DOUBLE_EQ(figures.level, 0.25);
  EXPECT_GE(figures.bright, 1.0);
  EXPECT_NEAR(figures.saturated, 0.02, 0.002);
  EXPECT_EQ(FiguresOf(Frame([](int, int) { return 3999; }).view(), 4000).saturated, 0.0);
  EXPECT_EQ(FiguresOf(Image<uint16_t>(8, 8).view(), 4000).focus, 0.0) << "too small for any";
}

}  // namespace
}  // namespace stratalux::rig
