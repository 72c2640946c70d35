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
  EXPECT_LT(Rms(QuietDarkFrame({mean.view(), 3}, Camera()), truth), 0.45);
}

TEST(QuietDarkFrame, KeepsAStrongFixedPattern) {
  Image<float> truth;
  const auto mean = MeanOfFrames(3, 10.0, 2, truth);
  EXPECT_LT(Rms(QuietDarkFrame({mean.view(), 3}, Camera()), truth), Rms(mean, truth) * 1.02);
}

TEST(QuietDarkFrame, IsNeverWorseThanTheMeanForAFixedPatternLikeTheNoise) {
  Image<float> truth;
  const auto mean = MeanOfFrames(3, 1.7, 3, truth);
  const double quiet = Rms(QuietDarkFrame({mean.view(), 3}, Camera()), truth);
  EXPECT_LT(quiet, Rms(mean, truth));
  EXPECT_LT(quiet, 1.7);  // and better than leaving the pattern out
}

TEST(QuietDarkFrame, LeavesAHotPixelAloneAndItsNeighboursClean) {
  Image<float> truth;
  auto mean = MeanOfFrames(3, 0.0, 4, truth);
  mean(40, 40) += 900.0F;
  const auto quiet = QuietDarkFrame({mean.view(), 3}, Camera());
  EXPECT_NEAR(quiet(40, 40), mean(40, 40), 0.5);
  EXPECT_NEAR(quiet(42, 40), truth(42, 40), 2.0);
}

TEST(QuietDarkFrame, NoiseFreeFramesStay) {
  Image<float> truth;
  MeanOfFrames(3, 0.0, 5, truth);
  EXPECT_LT(Rms(QuietDarkFrame({truth.view(), 3}, Camera()), truth), 0.05);
}

// A face under a projector's black: what white shows of it (fine structure and an edge included), `leak` of it, on
// ambient light that falls off to one side.
struct Leaking {
  Image<float> white, black, truth;

  Leaking(double leak, uint64_t seed) : white(kWidth, kHeight), black(kWidth, kHeight), truth(kWidth, kHeight) {
    Random random(seed);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        const bool face = std::hypot(x - 48.0, y - 40.0) < 34.0;
        const double shown = face ? 900.0 + 400.0 * std::sin(0.9 * x) * std::cos(0.7 * y) : 0.0;
        truth(x, y) = static_cast<float>(64.0 + 0.005 * x + leak * shown);
        white(x, y) = static_cast<float>(truth(x, y) + (1.0 - leak) * shown +
                                         std::sqrt(9.0 + shown / 4.0) / std::sqrt(5.0) * random.Normal());
        black(x, y) = static_cast<float>(truth(x, y) + 3.0 / std::sqrt(3.0) * random.Normal());
      }
  }
};

TEST(QuietDarkFrame, WhiteGuidesWhatTheProjectorsBlackAdds) {
  for (const double leak : {0.0, 0.002, 0.02}) {
    const Leaking session(leak, 6);
    const MeanFrame black = {session.black.view(), 3};
    const double guided = Rms(QuietDarkFrame(black, Camera(), {session.white.view(), 5}), session.truth);
    // Two numbers by 961 sites, fewer at the picture's edge.
    EXPECT_LT(guided, 0.16) << leak;
    EXPECT_LT(guided, 0.5 * Rms(QuietDarkFrame(black, Camera()), session.truth)) << leak;
  }
}

TEST(QuietDarkFrame, UnknownWhiteIsNoGuideAndHurtsNobody) {
  // Sites that saturated, a block of them, and a hot pixel.
  Leaking session(0.02, 7);
  for (int y = 30; y < 50; ++y)
    for (int x = 30; x < 50; ++x) session.white(x, y) = std::nanf("");
  session.black(70, 40) += 2000.0F;
  const MeanFrame black = {session.black.view(), 3};
  const Image<float> alone = QuietDarkFrame(black, Camera()),
                     guided = QuietDarkFrame(black, Camera(), {session.white.view(), 5});
  double squares = 0.0, unguided = 0.0, unguided_alone = 0.0;
  int sites = 0;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_TRUE(std::isfinite(guided(x, y)));
      const double square = std::pow(guided(x, y) - session.truth(x, y), 2);
      if (x >= 30 && x < 50 && y >= 30 && y < 50) {
        unguided += square;
        unguided_alone += std::pow(alone(x, y) - session.truth(x, y), 2);
      } else if (x != 70 || y != 40) {
        squares += square;
        ++sites;
      }
    }
  EXPECT_LT(std::sqrt(squares / sites), 0.25);
  // A share of their own.
  EXPECT_LT(unguided, 1.3 * unguided_alone);
  EXPECT_NEAR(guided(70, 40), session.black(70, 40), 0.5);
}

TEST(QuietDarkFrame, NoLineIsForcedOnASkinThatARoomLightsOtherwiseThanTheProjector) {
  // The room's light times an albedo that varies, and the projector's black and white of it but for a cast shadow: two
  // proportions of one picture.
  for (const double room_dn : {0.0, 20.0}) {
    Random random(8);
    Image<float> white(kWidth, kHeight), black(kWidth, kHeight), truth(kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        const double albedo = 0.4 * (1.0 + 0.2 * std::sin(0.15 * x) * std::cos(0.12 * y)),
                     projector = x + y / 2 < 60 ? 800.0 : 0.0;
        truth(x, y) = static_cast<float>(64.0 + (room_dn + 0.002 * projector) * albedo);
        black(x, y) = static_cast<float>(truth(x, y) + 3.0 / std::sqrt(3.0) * random.Normal());
        white(x, y) = static_cast<float>(truth(x, y) + projector * albedo + random.Normal());
      }
    const MeanFrame frames = {black.view(), 3};
    const double guided = Rms(QuietDarkFrame(frames, Camera(), {white.view(), 5}), truth),
                 alone = Rms(QuietDarkFrame(frames, Camera()), truth);
    // 25 sites have a fifth of one's noise, 0.36.
    EXPECT_LT(guided, 1.3 * alone) << room_dn;
    EXPECT_LT(guided, room_dn > 0.0 ? 0.55 : 0.25) << room_dn;
  }
}

}  // namespace
}  // namespace stratalux::fit
