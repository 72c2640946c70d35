// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/prediction_error.h"

#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

constexpr PredictionError kTrue{0.03, 0.01, 0.06, 0.02, 0, 1000.0};

enum class Tails { kNormal, kHeavy };

// Of unit variance. Heavy: one in ten is three times as large as the others.
double ErrorOf(Random& random, Tails tails) {
  if (tails == Tails::kNormal) return random.Normal();
  const double scale = random.Uniform() < 0.1 ? 3.0 : 1.0;
  return scale * random.Normal() / std::sqrt(0.1 * 9.0 + 0.9);
}

// Pixels whose errors have the parts of kTrue; two takes with noise of `noise_share` of sigma each.
std::vector<ErrorSample> Draw(int count, double noise_share, Tails tails, uint64_t seed) {
  Random random(seed);
  std::vector<ErrorSample> samples;
  for (int k = 0; k < count; ++k) {
    ErrorSample s;
    const double p = 20.0 + 400.0 * random.Uniform();
    s.causes = {static_cast<float>(p), static_cast<float>(3.0 * random.Uniform()),
                static_cast<float>(p * random.Uniform()), static_cast<float>(200.0 * random.Uniform())};
    const double sigma = kTrue.Sigma(s.causes), noise = noise_share * sigma;
    const double error = sigma * ErrorOf(random, tails);
    const double first = error + std::sqrt(2.0) * noise * random.Normal(),
                 second = error + std::sqrt(2.0) * noise * random.Normal();
    s.residual = static_cast<float>(0.5 * (first + second));
    s.squared_error = static_cast<float>(first * second);
    s.noise_variance = static_cast<float>(noise * noise);
    samples.push_back(s);
  }
  return samples;
}

TEST(PredictionErrorTest, FindsThePartsThroughTheNoise) {
  for (const double noise : {0.0, 1.0}) {
    const auto error = LearnPredictionError(Draw(60000, noise, Tails::kNormal, 3));
    ASSERT_TRUE(error);
    EXPECT_NEAR(error->albedo, kTrue.albedo, 0.1 * kTrue.albedo) << noise;
    EXPECT_NEAR(error->normal_rad, kTrue.normal_rad, 0.1 * kTrue.normal_rad) << noise;
    EXPECT_NEAR(error->placement_quads, kTrue.placement_quads, 0.1 * kTrue.placement_quads) << noise;
    EXPECT_NEAR(error->spread, kTrue.spread, 0.1 * kTrue.spread) << noise;
  }
}

TEST(PredictionErrorTest, TakesNoiseForErrorWhereItIsNotTakenOff) {
  auto samples = Draw(60000, 1.0, Tails::kNormal, 4);
  const double honest = LearnPredictionError(samples)->albedo;
  for (ErrorSample& s : samples) {
    s.squared_error = s.residual * s.residual;
    s.noise_variance = 0.0F;
  }
  EXPECT_GT(LearnPredictionError(samples)->albedo, 1.25 * honest);
}

// Of other pixels than it was learnt from, without any noise: the truth.
TEST(PredictionErrorTest, CoversNineteenOfTwentyOfTheTruth) {
  for (const Tails tails : {Tails::kNormal, Tails::kHeavy})
    for (const double noise : {0.3, 1.5}) {
      const auto error = LearnPredictionError(Draw(40000, noise, tails, 5));
      ASSERT_TRUE(error);
      EXPECT_NEAR(ShareWithin(Draw(40000, 0.0, tails, 6), *error), 0.95, 0.015) << noise;
      EXPECT_NEAR(ShareWithin(Draw(40000, noise, tails, 7), *error), 0.95, 0.015) << noise;
    }
}

TEST(PredictionErrorTest, IsNotToldByTooFewOrUnusableSamples) {
  auto samples = Draw(150, 0.5, Tails::kNormal, 8);
  EXPECT_FALSE(LearnPredictionError(samples));
  samples.resize(1000, {{std::nanf(""), 0.0F, 0.0F, 0.0F}, 1.0F, 1.0F, 1.0F});
  EXPECT_FALSE(LearnPredictionError(samples));
  EXPECT_TRUE(std::isnan(ShareWithin({}, kTrue)));
}

// Nothing is stated that was not found: a capture whose takes agree less with each other than with the prediction.
TEST(PredictionErrorTest, NoiseAloneIsNoError) {
  auto samples = Draw(2000, 1.0, Tails::kNormal, 9);
  for (ErrorSample& s : samples) s.squared_error = -std::abs(s.squared_error);
  EXPECT_FALSE(LearnPredictionError(samples));
}

// Light that only scatters round the edge of shadow does not follow the cosine: no incidence is told of it.
TEST(PredictionErrorTest, TakesNoIncidenceBeyondThoseItWasLearntFrom) {
  const auto error = LearnPredictionError(Draw(40000, 0.0, Tails::kNormal, 10));
  ASSERT_TRUE(error);
  EXPECT_NEAR(error->most_tan_incidence, 3.0, 0.01);
  const ErrorCauses grazing{100.0F, static_cast<float>(error->most_tan_incidence), 0.0F, 0.0F},
      shadow{100.0F, 1000.0F, 0.0F, 0.0F};
  EXPECT_FLOAT_EQ(static_cast<float>(error->Sigma(shadow)), static_cast<float>(error->Sigma(grazing)));
}

// A slope of light across a tilted plane: steps, spread and angles as worked out by hand. Of skin whose own
// pattern shows under white light as well only the light's steps count.
TEST(PredictionErrorTest, ReadsTheCausesOffThePrediction) {
  constexpr int kSize = 41;
  SurfaceMap surface;
  surface.point_mm = surface.normal = Image<float>(kSize, kSize, 3);
  surface.mask = Image<uint8_t>(kSize, kSize, 1, 1);
  Image<float> prediction(kSize, kSize, 1);
  for (int j = 0; j < kSize; ++j)
    for (int i = 0; i < kSize; ++i) {
      for (int k = 0; k < 3; ++k) {
        surface.point_mm(i, j, k) = static_cast<float>(k == 0 ? i : k == 1 ? j : 700);
        surface.normal(i, j, k) = k == 2 ? -1.0F : 0.0F;
      }
      prediction(i, j, 0) = static_cast<float>(100 + 3 * i + 4 * j);
    }
  prediction(30, 20, 0) = std::nanf("");
  const Image<float> white(kSize, kSize, 1, 500.0F);
  const Eigen::Vector3d light_mm(20.0 + 700.0, 20.0, 0.0);
  const ErrorCauseMaps maps(surface, light_mm, prediction, white);
  const ErrorCauses middle = maps.At(20, 20, 0);
  EXPECT_FLOAT_EQ(middle.prediction, 240.0F);
  EXPECT_FLOAT_EQ(middle.step, 5.0F);
  EXPECT_NEAR(middle.tan_incidence, 1.0, 1e-5);
  EXPECT_FLOAT_EQ(middle.spread, 240.0F * (1.0F - 240.0F / 500.0F));
  EXPECT_FLOAT_EQ(maps.At(29, 20, 0).step, 5.0F) << "by its other neighbour";
  Image<float> spotted = white, of_spotted = prediction;
  for (int j = 0; j < kSize; ++j)
    for (int i = 0; i < kSize; ++i) {
      const float darker = (i + j) % 3 == 0 ? 0.2F : 0.8F;
      spotted(i, j, 0) *= darker;
      of_spotted(i, j, 0) *= darker;
    }
  EXPECT_NEAR(ErrorCauseMaps(surface, light_mm, of_spotted, spotted).At(20, 20, 0).step, 0.8 * 5.0, 1e-4);
  EXPECT_EQ(ErrorCauseMaps(surface, light_mm, spotted, spotted).At(20, 20, 0).step, 0.0F) << "no pattern";
}

// Twice the light, twice the interval: they hold for lights of any strength.
TEST(PredictionErrorTest, IntervalsScaleWithTheLight) {
  constexpr int kSize = 12;
  SurfaceMap surface;
  surface.point_mm = surface.normal = Image<float>(kSize, kSize, 3);
  surface.mask = Image<uint8_t>(kSize, kSize, 1, 1);
  surface.mask(0, 0) = 0;
  Image<float> dim(kSize, kSize, 1), bright = dim;
  for (int j = 0; j < kSize; ++j)
    for (int i = 0; i < kSize; ++i) {
      surface.point_mm(i, j, 0) = static_cast<float>(i);
      surface.point_mm(i, j, 1) = static_cast<float>(j);
      surface.point_mm(i, j, 2) = 700.0F;
      surface.normal(i, j, 2) = -1.0F;
      dim(i, j, 0) = static_cast<float>(1 + (i * 7 + j * 3) % 5);
      bright(i, j, 0) = 2.0F * dim(i, j, 0);
    }
  const Eigen::Vector3d light_mm(300.0, 0.0, 0.0);
  const Image<float> white(kSize, kSize, 1, 8.0F), brighter(kSize, kSize, 1, 16.0F);
  const auto of_dim = HalfWidths(surface, light_mm, dim, white, {&kTrue, 1}),
             of_bright = HalfWidths(surface, light_mm, bright, brighter, {&kTrue, 1});
  EXPECT_EQ(of_dim(0, 0, 0), 0.0F) << "no surface";
  EXPECT_GT(of_dim(5, 5, 0), 0.0F);
  for (int j = 0; j < kSize; ++j)
    for (int i = 0; i < kSize; ++i) EXPECT_NEAR(of_bright(i, j, 0), 2.0F * of_dim(i, j, 0), 1e-5F);
}

}  // namespace
}  // namespace stratalux::fit
