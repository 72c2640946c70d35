// SPDX-License-Identifier: Apache-2.0
// EM on cycles some of whose combs are left out: lines further apart than they are wide.
#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "fitter/mixture/em_light.h"
#include "tests/fitter/mixture/known_lights.h"

namespace stratalux::fit {
namespace {

constexpr int kThinnedProfiles = 64;
enum class White { kNone, kKnown };

EmOptions OptionsOf(int sweeps) {
  EmOptions options;
  options.surface_term = false;
  options.max_iterations = sweeps;
  return options;
}

// One comb in `every` of those of `whole`. White frames of 0.3 % of noise say what all combs together are.
SrdBatch Thinned(const SrdBatch& whole, int every, White white) {
  SrdBatch b = whole;
  b.samples = whole.samples / every;
  b.y.clear();
  for (int64_t i = 0; i < whole.profiles(); ++i) {
    for (int k = 0; k < b.samples; ++k) b.y.push_back(whole.Samples(i)[k * every]);
    b.step_mm[i] *= static_cast<float>(every);
    if (white == White::kNone) continue;
    const auto y = whole.Samples(i);
    b.white.push_back(std::accumulate(y.begin(), y.end(), 0.0F) / static_cast<float>(every));
    b.white_variance.push_back(std::pow(0.003F * b.white.back(), 2.0F));
  }
  return b;
}

std::vector<SrdBatch> ThinnedLights(int every, White white, double peak_counts, const EmOptions& options) {
  Random random(1);
  std::vector<SrdBatch> lights;
  for (const double slope : {-1.0, 0.0, 0.58})
    lights.push_back(
        Thinned(test::CombOf(test::FiveLayers(), slope, kThinnedProfiles, peak_counts, options, random), every, white));
  return lights;
}

MixtureMap Fit(const std::vector<SrdBatch>& batches, const EmOptions& options) {
  std::vector<const SrdBatch*> lights;
  for (const SrdBatch& b : batches) lights.push_back(&b);
  const auto map = FitMixture(lights, {0, 1, 2}, kThinnedProfiles, 1, 1, options);
  EXPECT_TRUE(map.ok()) << map.status().message();
  return *map;
}

double TotalOf(const LayerSet& layers) { return std::accumulate(layers.weight.begin(), layers.weight.end(), 0.0); }

// Mean over the profiles of the NRMSE of all samples of a light that no fit has seen.
double UnseenError(const MixtureMap& map, const EmOptions& options) {
  Random random(2);
  const SrdBatch unseen = test::CombOf(test::FiveLayers(), 1.0, kThinnedProfiles, 0.0, options, random);
  double mean = 0.0;
  for (int64_t i = 0; i < kThinnedProfiles; ++i) {
    const auto truth = PredictSamples(test::FiveLayers(), unseen, i, options.scattering),
               found = PredictSamples(LayersOf(map, i), unseen, i, options.scattering);
    double error = 0.0, power = 0.0;
    for (size_t k = 0; k < truth.size(); ++k) {
      error += std::pow(found[k] - truth[k], 2);
      power += std::pow(truth[k], 2);
    }
    mean += std::sqrt(error / power) / kThinnedProfiles;
  }
  return mean;
}

TEST(ThinnedCycle, IsOneWhoseLinesStandApart) {
  Random random(1);
  const SrdBatch whole = test::CombOf(test::FiveLayers(), 0.0, 1, 0.0, {}, random);
  EXPECT_FALSE(IsThinned(whole, 0));
  EXPECT_TRUE(IsThinned(Thinned(whole, 2, White::kNone), 0));
}

// Wherever a pixel lies between the lines. Where EM took all cells to be seen alike, a pixel under a line had several
// times the weight of one between two.
TEST(ThinnedCycle, TotalsAreThoseOfTheWhiteFrames) {
  const EmOptions options = OptionsOf(60);
  for (const int every : {4, 8}) {
    const MixtureMap map = Fit(ThinnedLights(every, White::kKnown, 4000, options), options);
    for (int64_t i = 0; i < kThinnedProfiles; ++i)
      EXPECT_NEAR(TotalOf(LayersOf(map, i)) / TotalOf(test::FiveLayers()), 1.0, 0.02) << every << ", " << i;
  }
}

TEST(ThinnedCycle, PredictsUnseenLightNearlyAsTheWholeCycleDoes) {
  const EmOptions options = OptionsOf(60);
  const double whole = UnseenError(Fit(ThinnedLights(1, White::kNone, 4000, options), options), options);
  const double half = UnseenError(Fit(ThinnedLights(2, White::kKnown, 4000, options), options), options);
  const double quarter = UnseenError(Fit(ThinnedLights(4, White::kKnown, 4000, options), options), options);
  EXPECT_LT(whole, 0.03);
  EXPECT_LT(half, 0.05);
  EXPECT_LT(quarter, 0.12);
}

// Exact EM: plain sweeps never lose likelihood.
TEST(ThinnedCycle, MoreSweepsNeverFitWorse) {
  EmOptions options = OptionsOf(4);
  options.accelerated = false;
  options.tolerance = 0.0;
  const auto lights = ThinnedLights(4, White::kNone, 4000, options);
  MixtureMap before = Fit(lights, options);
  for (options.max_iterations = 8; options.max_iterations <= 64; options.max_iterations *= 2) {
    const MixtureMap map = Fit(lights, options);
    for (size_t i = 0; i < map.divergence.size(); ++i)
      EXPECT_LE(map.divergence[i], before.divergence[i] * 1.00001F) << options.max_iterations << ", " << i;
    before = map;
  }
}

}  // namespace
}  // namespace stratalux::fit
