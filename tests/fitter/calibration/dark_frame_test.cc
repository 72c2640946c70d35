// SPDX-License-Identifier: Apache-2.0
#include "fitter/sensor/dark_frame.h"

#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

constexpr int kWidth = 96, kHeight = 80;

CameraCalibration Camera() {
  CameraCalibration camera;
  camera.cfa = Cfa::kRggb;
  camera.black_level_dn = 64.0;
  camera.gain_e_per_dn = 4.0;
  camera.read_noise_dn = 3.0;
  return camera;
}

// Truth of one site: black level, ambient light that grows to the right and differs by colour.
float Level(int x, int y) {
  return 64.0F + 0.05F * static_cast<float>(x) + 2.0F * static_cast<float>(CfaColour(Cfa::kRggb, x, y));
}

Image<float> MeanOfFrames(int count, double fixed_pattern_dn, uint64_t seed, Image<float>& truth) {
  Random random(seed);
  Image<float> mean(kWidth, kHeight);
  truth = Image<float>(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      truth(x, y) = Level(x, y) + static_cast<float>(fixed_pattern_dn * random.Normal());
      mean(x, y) = truth(x, y) + static_cast<float>(3.0 / std::sqrt(count) * random.Normal());
    }
  return mean;
}

double Rms(const Image<float>& a, const Image<float>& b) {
  double sum = 0.0;
  for (size_t i = 0; i < a.size(); ++i) sum += std::pow(a.pixels()[i] - b.pixels()[i], 2);
  return std::sqrt(sum / static_cast<double>(a.size()));
}

TEST(QuietDarkFrame, RemovesReadNoiseWhereTheSensorHasNoFixedPattern) {
  Image<float> truth;
  const auto mean = MeanOfFrames(3, 0.0, 1, truth);
  EXPECT_GT(Rms(mean, truth), 1.6);
  // The mean of 25 sites has a fifth of one site's noise; edges see fewer.
  EXPECT_LT(Rms(QuietDarkFrame(mean, 3, Camera()), truth), 0.45);
}

TEST(QuietDarkFrame, KeepsAStrongFixedPattern) {
  Image<float> truth;
  const auto mean = MeanOfFrames(3, 10.0, 2, truth);
  EXPECT_LT(Rms(QuietDarkFrame(mean, 3, Camera()), truth), Rms(mean, truth) * 1.02);
}

TEST(QuietDarkFrame, IsNeverWorseThanTheMeanForAFixedPatternLikeTheNoise) {
  Image<float> truth;
  const auto mean = MeanOfFrames(3, 1.7, 3, truth);
  const double quiet = Rms(QuietDarkFrame(mean, 3, Camera()), truth);
  EXPECT_LT(quiet, Rms(mean, truth));
  EXPECT_LT(quiet, 1.7);  // and better than leaving the pattern out
}

TEST(QuietDarkFrame, LeavesAHotPixelAloneAndItsNeighboursClean) {
  Image<float> truth;
  auto mean = MeanOfFrames(3, 0.0, 4, truth);
  mean(40, 40) += 900.0F;
  const auto quiet = QuietDarkFrame(mean, 3, Camera());
  EXPECT_NEAR(quiet(40, 40), mean(40, 40), 0.5);
  EXPECT_NEAR(quiet(42, 40), truth(42, 40), 2.0);
}

TEST(QuietDarkFrame, NoiseFreeFramesStay) {
  Image<float> truth;
  MeanOfFrames(3, 0.0, 5, truth);
  EXPECT_LT(Rms(QuietDarkFrame(truth, 3, Camera()), truth), 0.05);
}

}  // namespace
}  // namespace stratalux::fit
