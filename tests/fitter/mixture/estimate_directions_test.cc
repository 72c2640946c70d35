// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/estimate_directions.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "fitter/mixture/fit_mixture.h"
#include "tests/fitter/mixture/em_cases.h"

namespace stratalux::fit {
namespace {

EmOptions SixLayers() {
  EmOptions options;
  options.layers = 6;
  options.surface_term = false;
  options.background_term = false;
  return options;
}

// Profiles of a skin whose deep layers lose light on the oblique way.
EmCases Skins(double kappa_per_mm, double tau) {
  EmOptions truth = SixLayers();
  truth.scattering.tau = tau;
  truth.scattering.directional.kappa_per_mm = kappa_per_mm;
  return MakeEmCases({.profiles = 96, .peak_counts = 50000.0, .alike = 32}, truth, 5);
}

TEST(EstimateDirections, ExplainsTheTrainingLightsNoWorseThanTauAlone) {
  const EmCases cases = Skins(0.8, 0.0);
  const auto estimate = EstimateDirections(cases.lights(), 1, SixLayers(), 2);
  ASSERT_TRUE(estimate.ok());
  EXPECT_GT(estimate->weights.kappa_per_mm, 0.0);
  EXPECT_LT(estimate->divergence, 0.99 * estimate->divergence_without);
}

TEST(EstimateDirections, AddsNothingWhereLightKnowsNoDirection) {
  const EmCases cases = Skins(0.0, 0.4);
  const auto lights = cases.lights();
  const auto estimate = EstimateDirections(lights, 1, SixLayers(), 2);
  ASSERT_TRUE(estimate.ok());
  EXPECT_NEAR(estimate->tau, 0.4, 0.1);
  EXPECT_LE(estimate->weights.kappa_per_mm, 0.2);
}

TEST(EstimateDirections, ReadsPooledProfilesAsTheFitDoes) {
  EmOptions options = SixLayers();
  const EmCases cases = MakeEmCases({.profiles = 32, .peak_counts = 50000.0, .pool = 2}, options, 7);
  const auto lights = cases.lights();
  const auto estimate = EstimateDirections(lights, 1, options, 1);
  ASSERT_TRUE(estimate.ok());
  options.scattering.tau = estimate->tau;
  const auto map = FitMixture(lights, {0, 1, 2}, 32, 1, 1, options);
  ASSERT_TRUE(map.ok());
  // A mean of the profiles' divergences.
  const auto [least, most] = std::minmax_element(map->divergence.begin(), map->divergence.end());
  EXPECT_GT(estimate->divergence_without, *least);
  EXPECT_LT(estimate->divergence_without, *most);
}

TEST(EstimateDirections, KeepsTauWhereNoPixelSeesAllLights) {
  EmOptions options;
  options.layers = 3;
  options.scattering.tau = 0.3;
  EmCases cases = MakeEmCases({.profiles = 16}, options, 6);
  for (int64_t i = 0; i < 16; ++i) cases.batches[static_cast<size_t>(i) % 3].valid[static_cast<size_t>(i)] = 0;
  const auto estimate = EstimateDirections(cases.lights(), 1, options, 1);
  ASSERT_TRUE(estimate.ok());
  EXPECT_EQ(estimate->tau, 0.3);
}

}  // namespace
}  // namespace stratalux::fit
