// SPDX-License-Identifier: Apache-2.0
#include "fitter/image/gaussian_blur.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

// Tap by tap in both directions; outside is zero.
double BlurredAt(const Image<float>& image, const std::vector<float>& taps, int x, int y, int c) {
  const int reach = static_cast<int>(taps.size() / 2);
  double sum = 0.0;
  for (int b = -reach; b <= reach; ++b)
    for (int a = -reach; a <= reach; ++a)
      if (x + a >= 0 && y + b >= 0 && x + a < image.width() && y + b < image.height())
        sum += double{taps[static_cast<size_t>(a + reach)]} * double{taps[static_cast<size_t>(b + reach)]} *
               double{image(x + a, y + b, c)};
  return sum;
}

// What is not zero lies anywhere: all over, in the middle, in a corner, in one pixel, nowhere.
TEST(GaussianBlur, IsTheSumOfItsTapsWhereverTheImageIsFilled) {
  struct Rectangle {
    int x0, y0, x1, y1;
  };
  Random random(7, 3);
  for (const double sigma : {0.7, 1.0, 3.0})
    for (const int channels : {1, 3})
      for (const auto& [x0, y0, x1, y1] :
           {Rectangle{0, 0, 41, 29}, {12, 9, 30, 14}, {0, 20, 3, 29}, {40, 0, 41, 1}, {5, 5, 5, 5}}) {
        Image<float> image(41, 29, channels);
        for (int y = y0; y < y1; ++y)
          for (int x = x0; x < x1; ++x)
            for (int c = 0; c < channels; ++c) image(x, y, c) = static_cast<float>(random.Normal());
        const Image<float> blurred = GaussianBlur(image, sigma);
        ASSERT_EQ(blurred.width(), 41);
        ASSERT_EQ(blurred.height(), 29);
        ASSERT_EQ(blurred.channels(), channels);
        for (int y = 0; y < 29; ++y)
          for (int x = 0; x < 41; ++x)
            for (int c = 0; c < channels; ++c)
              ASSERT_NEAR(blurred(x, y, c), BlurredAt(image, GaussianTaps(sigma), x, y, c), 2e-6)
                  << sigma << ", filled from " << x0 << ", " << y0 << ": " << x << ", " << y << ", " << c;
      }
}

TEST(GaussianBlur, OfAPictureNarrowerThanItsReachLosesWhatFallsOutside) {
  const Image<float> image(3, 2, 1, 1.0F);
  const Image<float> blurred = GaussianBlur(image, 4.0);
  for (int y = 0; y < 2; ++y)
    for (int x = 0; x < 3; ++x) EXPECT_NEAR(blurred(x, y), BlurredAt(image, GaussianTaps(4.0), x, y, 0), 1e-6);
}

TEST(NoiseAboveBlur, IsWhatIsLeftOfWhiteNoise) {
  Random random(11, 5);
  Image<float> noise(300, 300);
  for (float& v : noise.pixels()) v = static_cast<float>(random.Normal());
  const Image<float> blurred = GaussianBlur(noise, 1.5);
  double squares = 0.0;
  for (int y = 10; y < 290; ++y)
    for (int x = 10; x < 290; ++x) squares += std::pow(double{noise(x, y)} - double{blurred(x, y)}, 2);
  EXPECT_NEAR(squares / (280.0 * 280.0), NoiseAboveBlur(1.5), 0.02);
}

}  // namespace
}  // namespace stratalux::fit
