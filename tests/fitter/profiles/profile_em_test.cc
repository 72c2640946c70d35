// SPDX-License-Identifier: Apache-2.0
#include "fitter/profiles/profile_em.h"

#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "tests/fitter/mixture/known_lights.h"
#include "tests/fitter/mixture/reference_em.h"

namespace stratalux::fit {
namespace {

EmOptions Options() {
  EmOptions options;
  options.surface_term = false;
  options.scattering.gain_model = false;
  options.layers = 12;
  options.max_iterations = 50;
  return options;
}

std::vector<ProfileLight> Combs(const EmOptions& truth, uint64_t seed, double peak_counts = 4000.0) {
  Random random(seed);
  std::vector<ProfileLight> lights;
  for (double slope : {-1.0, 0.0, 0.577})
    lights.push_back(
        ProfileLightOf(test::CombOf(test::FiveLayers(), slope, 1, peak_counts, truth, random), 0, Options()));
  return lights;
}

TEST(ProfileEm, NeverEndsAboveAsManyPlainSweepsOfTheReference) {
  EmOptions options = Options();
  options.tolerance = 0.0;
  options.max_iterations = 30;
  for (uint64_t seed : {1, 2, 3}) {
    const auto lights = Combs(options, seed);
    const LayerSet start = SpreadLayers(lights, options);
    const ProfileFit fast = RunProfileEm(lights, start, options);
    EXPECT_LE(fast.divergence, FitReference(lights, start, options).divergence) << seed;
    EXPECT_EQ(fast.iterations, 30);
  }
}

TEST(ProfileEm, EndsWhereTheReferenceEnds) {
  // Two layers, which the data do identify: there both stand still at the same place.
  EmOptions options = Options();
  options.layers = 2;
  options.tolerance = 0.0;
  options.max_iterations = 900;
  const auto lights = Combs(options, 4);
  const LayerSet start = SpreadLayers(lights, options);
  const ProfileFit fit = RunProfileEm(lights, start, options), reference = FitReference(lights, start, options);
  EXPECT_NEAR(fit.divergence / reference.divergence, 1.0, 1e-9);
  for (size_t l = 0; l < 2; ++l) {
    EXPECT_NEAR(fit.layers.weight[l] / reference.layers.weight[l], 1.0, 1e-5);
    EXPECT_NEAR(fit.layers.depth_mm[l], reference.layers.depth_mm[l], 1e-5);
    EXPECT_NEAR(fit.layers.sigma_mm[l] / reference.layers.sigma_mm[l], 1.0, 1e-5);
  }
}

TEST(ProfileEm, DivergenceNeverRises) {
  EmOptions options = Options();
  const auto lights = Combs(options, 3);
  const LayerSet start = SpreadLayers(lights, options);
  options.tolerance = 0.0;
  double last = 1e300;
  for (int sweeps : {3, 6, 9, 18, 33}) {
    options.max_iterations = sweeps;
    const double now = RunProfileEm(lights, start, options).divergence;
    EXPECT_LE(now, last * (1.0 + 1e-9)) << sweeps;
    last = now;
  }
}

TEST(ProfileEm, FindsHowLayersDependOnDirection) {
  EmOptions truth = Options();
  truth.scattering.directional = {1.0, 1.3, 0.4};
  EmOptions options = Options();
  const auto lights = Combs(truth, 1, 0.0);
  const LayerSet start = SpreadLayers(lights, options);
  options.max_iterations = 150;
  const ProfileFit with = RunProfileEm(lights, start, options, SharedParameters::kTauAndDirectional),
                   without = RunProfileEm(lights, start, options);
  Random random(1);
  const SrdBatch unseen = test::CombOf(test::FiveLayers(), 1.3, 1, 0.0, truth, random);
  auto error = [&](const ProfileFit& fit) {
    ScatteringModel own = options.scattering;
    own.directional = fit.directional;
    const auto y = PredictSamples(fit.layers, unseen, 0, own);
    double sum = 0.0, power = 0.0;
    for (int k = 0; k < unseen.samples; ++k) {
      sum += std::pow(y[k] + fit.background[0] - unseen.y[k], 2);
      power += std::pow(unseen.y[k], 2);
    }
    return std::sqrt(sum / power);
  };
  EXPECT_LT(error(with), 0.03);
  EXPECT_LT(error(with), 0.65 * error(without));
}

TEST(ProfileEm, EmptyAndNegativeSamplesGiveFiniteLayers) {
  const EmOptions options = Options();
  auto lights = Combs(options, 1);
  for (double scale : {0.0, -1.0}) {
    for (ProfileLight& light : lights)
      for (double& y : light.y) y = scale * std::abs(y);
    const ProfileFit fit = RunProfileEm(lights, SpreadLayers(lights, options), options);
    for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
      EXPECT_TRUE(std::isfinite(fit.layers.weight[l]) && fit.layers.weight[l] >= 0.0);
      EXPECT_TRUE(std::isfinite(fit.layers.depth_mm[l]) && std::isfinite(fit.layers.sigma_mm[l]));
    }
    EXPECT_TRUE(std::isfinite(fit.divergence));
  }
}

}  // namespace
}  // namespace stratalux::fit
