// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/standard_errors.h"

#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "tests/fitter/mixture/known_lights.h"

namespace stratalux::fit {
namespace {

struct Combs {
  std::vector<SrdBatch> batches;
  [[nodiscard]] std::vector<const SrdBatch*> pointers() const {
    std::vector<const SrdBatch*> list;
    for (const SrdBatch& b : batches) list.push_back(&b);
    return list;
  }
};

Combs MakeCombs(const std::vector<double>& slopes, int64_t profiles, double peak_counts, const EmOptions& options) {
  Random random(11);
  Combs combs;
  for (double slope : slopes)
    combs.batches.push_back(test::CombOf(test::FiveLayers(), slope, profiles, peak_counts, options, random));
  return combs;
}

EmOptions Options() {
  EmOptions options;
  options.surface_term = false;
  options.scattering.gain_model = false;
  options.max_iterations = 100;
  options.tolerance = 0.0;
  return options;
}

// Spread of the realisations over the mean standard error claimed for them.
struct Honesty {
  double weight = 0.0, depth = 0.0, width = 0.0;
};

Honesty HonestyOf(double peak_counts) {
  constexpr int kRealisations = 240;
  const EmOptions options = Options();
  const Combs combs = MakeCombs({-1.0, 0.0, 0.577}, kRealisations, peak_counts, options);
  const auto map = FitMixture(combs.pointers(), {0, 1, 2}, kRealisations, 1, 1, options);
  EXPECT_TRUE(map.ok());
  std::array<double, 3> mean{}, square{}, claimed{};
  for (int i = 0; i < kRealisations; ++i) {
    const auto e = EffectiveParametersOf(*map, i, combs.pointers(), options);
    const std::array<Estimate, 3> all = {e.total_weight, e.mean_depth_mm, e.effective_width_mm};
    for (int j = 0; j < 3; ++j) {
      mean[j] += all[j].value / kRealisations;
      square[j] += all[j].value * all[j].value / kRealisations;
      claimed[j] += all[j].standard_error / kRealisations;
    }
  }
  auto ratio = [&](int j) { return std::sqrt(square[j] - mean[j] * mean[j]) / claimed[j]; };
  return {ratio(0), ratio(1), ratio(2)};
}

TEST(StandardErrors, AreTheSpreadOverNoiseRealisations) {
  for (double peak_counts : {1000.0, 4000.0}) {
    const Honesty honesty = HonestyOf(peak_counts);
    EXPECT_NEAR(honesty.weight, 1.0, 0.25) << peak_counts;
    EXPECT_NEAR(honesty.depth, 1.0, 0.25) << peak_counts;
    EXPECT_NEAR(honesty.width, 1.0, 0.25) << peak_counts;
  }
}

TEST(StandardErrors, DepthWithoutAnyShiftIsNotClaimed) {
  const EmOptions options = Options();
  const Combs frontal = MakeCombs({0.0, 0.0}, 1, 4000.0, options);
  const auto map = FitMixture(frontal.pointers(), {0, 1}, 1, 1, 1, options);
  ASSERT_TRUE(map.ok());
  const auto e = EffectiveParametersOf(*map, 0, frontal.pointers(), options);
  EXPECT_GT(e.mean_depth_mm.standard_error, 0.5);
  EXPECT_LT(e.total_weight.standard_error, 0.02);
}

TEST(StandardErrors, FallWithTheSquareRootOfThePhotons) {
  const EmOptions options = Options();
  auto error = [&](double peak_counts) {
    const Combs combs = MakeCombs({-1.0, 0.0, 0.577}, 1, peak_counts, options);
    const auto map = FitMixture(combs.pointers(), {0, 1, 2}, 1, 1, 1, options);
    return EffectiveParametersOf(*map, 0, combs.pointers(), options);
  };
  const auto dim = error(2000.0), bright = error(32000.0);
  EXPECT_NEAR(dim.total_weight.standard_error / bright.total_weight.standard_error, 4.0, 0.4);
  EXPECT_NEAR(dim.mean_depth_mm.standard_error / bright.mean_depth_mm.standard_error, 4.0, 0.8);
}

// White frames hold the whole light: its error becomes theirs, whatever the samples say of shape.
TEST(StandardErrors, WhiteFramesHoldTheTotalWeight) {
  const EmOptions options = Options();
  Combs combs = MakeCombs({-1.0, 0.0, 0.577}, 1, 1000.0, options);
  const auto map = FitMixture(combs.pointers(), {0, 1, 2}, 1, 1, 1, options);
  ASSERT_TRUE(map.ok());
  const auto without = EffectiveParametersOf(*map, 0, combs.pointers(), options);
  constexpr double kOfWhite = 0.001;  // relative, of each light's whites
  for (SrdBatch& b : combs.batches) {
    const auto y = b.Samples(0);
    const float sum = std::accumulate(y.begin(), y.end(), 0.0F);
    b.white = {sum};
    b.white_variance = {static_cast<float>(kOfWhite * kOfWhite * sum * sum)};
  }
  const auto with = EffectiveParametersOf(*map, 0, combs.pointers(), options);
  EXPECT_GT(without.total_weight.standard_error, 3.0 * kOfWhite * without.total_weight.value);
  EXPECT_NEAR(with.total_weight.standard_error, kOfWhite / std::sqrt(3.0) * with.total_weight.value,
              0.1 * kOfWhite * with.total_weight.value);
  EXPECT_NEAR(with.mean_depth_mm.standard_error, without.mean_depth_mm.standard_error,
              0.1 * without.mean_depth_mm.standard_error)
      << "they know nothing of positions";
}

// As if N0 photons more had been seen: of shape alone, which endlessly many of them fix, and never of the light.
TEST(StandardErrors, APriorHoldsShapesAndNoLight) {
  const EmOptions options = Options();
  const Combs combs = MakeCombs({-1.0, 0.0, 0.577}, 1, 1000.0, options);
  auto map = FitMixture(combs.pointers(), {0, 1, 2}, 1, 1, 1, options);
  ASSERT_TRUE(map.ok());
  const auto none = EffectiveParametersOf(*map, 0, combs.pointers(), options);
  double depth = none.mean_depth_mm.standard_error, width = none.effective_width_mm.standard_error;
  for (const double photons : {3000.0, 3e5, 3e9}) {
    map->prior_photons = photons;
    const auto held = EffectiveParametersOf(*map, 0, combs.pointers(), options);
    EXPECT_LT(held.mean_depth_mm.standard_error, depth);
    EXPECT_LT(held.effective_width_mm.standard_error, width);
    EXPECT_GT(held.total_weight.standard_error, 0.3 * none.total_weight.standard_error) << photons;
    depth = held.mean_depth_mm.standard_error;
    width = held.effective_width_mm.standard_error;
  }
  EXPECT_LT(depth, 0.001);
  EXPECT_LT(width, 0.001);
}

// A model without a floor trades no light of its widest layers with one.
TEST(StandardErrors, AFloorCostsWidth) {
  EmOptions options = Options();
  const Combs combs = MakeCombs({-1.0, 0.0, 0.577}, 1, 1000.0, options);
  const auto map = FitMixture(combs.pointers(), {0, 1, 2}, 1, 1, 1, options);
  ASSERT_TRUE(map.ok());
  const auto without = EffectiveParametersOf(*map, 0, combs.pointers(), options);
  options.background_term = true;
  const auto with = EffectiveParametersOf(*map, 0, combs.pointers(), options);
  EXPECT_GT(with.effective_width_mm.standard_error, 1.05 * without.effective_width_mm.standard_error);
  EXPECT_GT(with.total_weight.standard_error, without.total_weight.standard_error);
}

TEST(StandardErrors, ProfilesThatAreNotFittedHaveNone) {
  const EmOptions options = Options();
  Combs combs = MakeCombs({-1.0, 0.577}, 1, 4000.0, options);
  for (SrdBatch& b : combs.batches) b.valid[0] = 0;
  const auto map = FitMixture(combs.pointers(), {0, 1}, 1, 1, 1, options);
  ASSERT_TRUE(map.ok());
  const auto e = EffectiveParametersOf(*map, 0, combs.pointers(), options);
  EXPECT_EQ(e.total_weight.value, 0.0);
  EXPECT_EQ(e.total_weight.standard_error, 0.0);
}

}  // namespace
}  // namespace stratalux::fit
