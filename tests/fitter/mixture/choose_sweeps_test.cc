// SPDX-License-Identifier: Apache-2.0
// What a fit costs, sweep by sweep, and how many sweeps it takes.
#include "fitter/mixture/choose_sweeps.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numeric>

#include <gtest/gtest.h>

#include "fitter/mixture/mean_layers.h"
#include "tests/fitter/mixture/em_cases.h"
#include "tests/fitter/mixture/reference_em.h"

namespace stratalux::fit {
namespace {

constexpr int kManyProfiles = 96;
const std::vector<int> kFourLights = {0, 1, 2, 3};

// One skin in a little variety, as neighbouring pixels are, under four lights.
EmCases FourLights(double peak_counts, uint64_t seed) {
  return MakeEmCases(
      {.profiles = kManyProfiles, .peak_counts = peak_counts, .alike = kManyProfiles, .slopes = {-1.0, 0.0, 0.58, 1.0}},
      {}, seed);
}

EmOptions WithPrior(double photons = 1000.0) {
  EmOptions options;
  options.prior.photons = photons;
  return options;
}

std::vector<LayerSet> MeanOf(const std::vector<const SrdBatch*>& lights, const EmOptions& options) {
  const auto mean = MeanLayers(lights, 1, options);
  EXPECT_TRUE(mean.ok()) << mean.status().message();
  return *mean;
}

TracedFit Traced(const EmCases& made, EmOptions options, int sweeps, int traced = 0) {
  options.refinement_iterations = sweeps;
  auto fit =
      FitTraced(made.lights(), kFourLights, kManyProfiles, 1, 1, options, MeanOf(made.lights(), options), traced);
  EXPECT_TRUE(fit.ok()) << fit.status().message();
  return *std::move(fit);
}

MixtureMap FitOfFour(const EmCases& made, EmOptions options, int sweeps) {
  options.refinement_iterations = sweeps;
  auto map = FitMixture(made.lights(), kFourLights, kManyProfiles, 1, 1, options, MeanOf(made.lights(), options));
  EXPECT_TRUE(map.ok()) << map.status().message();
  return *std::move(map);
}

void ExpectSameProfile(const MixtureMap& a, const MixtureMap& b, int64_t i) {
  for (const auto field : {&MixtureMap::weight, &MixtureMap::depth_mm, &MixtureMap::sigma_mm})
    for (int64_t at = i * a.layers; at < (i + 1) * a.layers; ++at) EXPECT_EQ((a.*field)[at], (b.*field)[at]) << i;
  EXPECT_EQ(a.divergence[i], b.divergence[i]) << i;
  EXPECT_EQ(a.iterations[i], b.iterations[i]) << i;
  EXPECT_EQ(a.reason[i], b.reason[i]) << i;
  EXPECT_EQ(a.prior_share[i], b.prior_share[i]) << i;
}

// By the reference in double precision.
TEST(FitTraced, CostIsThePosteriorsOfTheMeanLayersPrior) {
  const EmOptions options = WithPrior(3000.0);
  const EmCases made = FourLights(400.0, 72);
  const std::vector<LayerSet> mean = MeanOf(made.lights(), options);
  const TracedFit fit = Traced(made, options, 3);
  // The known pixel: what a start from the mean layers holds before its first sweep.
  const MixtureMap centre = FitOfFour(made, options, 0);
  const auto fit_of = [&](const MixtureMap& map, int64_t i) {
    ProfileFit one;
    one.layers = LayersOf(map, i);
    one.surface.assign(map.surface.begin() + i * 4, map.surface.begin() + (i + 1) * 4);
    one.background.assign(4, 0.0);
    return one;
  };
  int judged = 0;
  for (int64_t i = 0; i < kManyProfiles; i += 12) {
    std::vector<ProfileLight> lights;
    double photons = 0.0;
    for (const SrdBatch& light : made.batches) {
      lights.push_back(ProfileLightOf(light, i, options));
      for (const double y : lights.back().y)
        photons += lights.back().counts * std::max(y + lights.back().read_shift, 0.0);
    }
    // Neither map was scaled to white frames: there are none.
    const double nats = photons * PenalisedDivergence(lights, fit_of(centre, i), fit_of(fit.map, i), options);
    EXPECT_NEAR(fit.cost[i] / nats, 1.0, 2e-3) << i;
    ++judged;
  }
  EXPECT_EQ(judged, 8);
}

TEST(FitTraced, WhatIsNotFittedCostsNothingAndIsNoNumber) {
  const EmOptions options = WithPrior();
  EmCases made = FourLights(1000.0, 73);
  for (SrdBatch& light : made.batches) light.valid[8] = 0;
  const TracedFit fit = Traced(made, options, 3, 2);
  EXPECT_FALSE(fit.map.Fitted(8));
  for (int64_t i = 0; i < kManyProfiles; ++i) EXPECT_EQ(std::isfinite(fit.cost[i]), i != 8) << i;
  EXPECT_TRUE(std::isnan(fit.cost_after[8 * 2]));
}

TEST(FitTraced, IsTheSameForAnyNumberOfThreads) {
  const EmOptions options = WithPrior();
  const EmCases made = FourLights(400.0, 74);
  setenv("STRATALUX_THREADS", "1", 1);
  const TracedFit one = Traced(made, options, 4, 4);
  setenv("STRATALUX_THREADS", "3", 1);
  const TracedFit three = Traced(made, options, 4, 4);
  unsetenv("STRATALUX_THREADS");
  EXPECT_EQ(one.map.weight, three.map.weight);
  EXPECT_EQ(one.map.sigma_mm, three.map.sigma_mm);
  EXPECT_EQ(one.cost_after, three.cost_after);
}

// Traced sweeps cost what as many cost by themselves, bit for bit, of profiles that settle early, too; and whoever is
// traced ends where nobody looks.
TEST(FitTraced, TracedSweepsCostWhatAsManyCost) {
  EmOptions options = WithPrior(300.0);
  options.tolerance = 1e-3;  // some settle at the second look
  const EmCases made = FourLights(4000.0, 82);
  constexpr int kMost = 30, kTraced = 24;
  const TracedFit traced = Traced(made, options, kMost, kTraced), silent = Traced(made, options, kMost);
  EXPECT_TRUE(silent.cost_after.empty());
  ASSERT_EQ(traced.cost_after.size(), size_t{kManyProfiles} * kTraced);
  EXPECT_EQ(traced.cost, silent.cost);
  const MixtureMap untraced = FitOfFour(made, options, kMost);
  for (int64_t i = 0; i < kManyProfiles; ++i) ExpectSameProfile(traced.map, untraced, i);
  const auto [least, most] = std::ranges::minmax(traced.map.iterations);
  EXPECT_LT(least, kTraced);
  EXPECT_GT(most, kTraced);
  for (int sweeps = 1; sweeps <= kTraced; ++sweeps) {
    const TracedFit few = Traced(made, options, sweeps);
    for (size_t i = 0; i < kManyProfiles; ++i)
      EXPECT_EQ(traced.cost_after[i * kTraced + static_cast<size_t>(sweeps) - 1], few.cost[i]) << i << ", " << sweeps;
  }
}

// A fit from the mean layers ends where data could not tell it from EM that has settled, of pixels that were not
// sampled too: seen here by the sweeps themselves, run to the end that was chosen and far beyond it.
TEST(ChooseSweeps, IsTheFewestThatDataCannotTellFromEmThatHasSettled) {
  const EmOptions options = WithPrior();
  const EmCases made = FourLights(400.0, 79);
  const auto choice = ChooseSweeps(made.lights(), kFourLights, 1, options, MeanOf(made.lights(), options));
  ASSERT_TRUE(choice.ok()) << choice.status().message();
  ASSERT_TRUE(choice->Reached());
  EXPECT_EQ(choice->profiles, kManyProfiles);
  EXPECT_GT(choice->referee_sweeps, choice->sweeps);
  ASSERT_EQ(static_cast<int>(choice->trials.size()), choice->sweeps);
  for (size_t t = 0; t + 1 < choice->trials.size(); ++t) EXPECT_GT(choice->trials[t].excess_nats, kSweepToleranceNats);
  EmOptions endless = options;
  endless.tolerance = 0.0;
  endless.refinement_iterations = 300;
  const TracedFit fit = Traced(made, options, choice->sweeps);
  const auto end = FitTraced(made.lights(), kFourLights, kManyProfiles, 1, 1, endless, MeanOf(made.lights(), options));
  ASSERT_TRUE(end.ok()) << end.status().message();
  double above = 0.0;
  for (int64_t i = 0; i < kManyProfiles; ++i) above += (double(fit.cost[i]) - double(end->cost[i])) / kManyProfiles;
  EXPECT_NEAR(above, choice->trials.back().excess_nats, 5e-3);
}

// The less the mean layers count, the further is the way from them; and never more sweeps than are allowed.
TEST(ChooseSweeps, AsksForMoreWhereThePriorIsWeak) {
  EmOptions weak = WithPrior(30.0), strong = WithPrior(3000.0);
  weak.refinement_iterations = strong.refinement_iterations = 60;
  const EmCases made = FourLights(4000.0, 80);
  const std::vector<LayerSet> mean = MeanOf(made.lights(), weak);
  const auto far = ChooseSweeps(made.lights(), kFourLights, 1, weak, mean),
             near = ChooseSweeps(made.lights(), kFourLights, 1, strong, mean);
  ASSERT_TRUE(far.ok() && near.ok());
  EXPECT_GT(far->sweeps, near->sweeps);
  weak.refinement_iterations = 2;
  const auto cut = ChooseSweeps(made.lights(), kFourLights, 1, weak, mean);
  ASSERT_TRUE(cut.ok());
  EXPECT_EQ(cut->sweeps, 2);
  EXPECT_FALSE(cut->Reached());
}

TEST(ChooseSweeps, HasNothingToTryWhereNothingIsLit) {
  const EmOptions options = WithPrior();
  EmCases made = FourLights(400.0, 81);
  const std::vector<LayerSet> mean = MeanOf(made.lights(), options);
  for (SrdBatch& batch : made.batches) std::ranges::fill(batch.valid, uint8_t{0});
  const auto choice = ChooseSweeps(made.lights(), kFourLights, 1, options, mean);
  ASSERT_TRUE(choice.ok());
  EXPECT_EQ(choice->profiles, 0);
  EXPECT_EQ(choice->sweeps, 0);
}

}  // namespace
}  // namespace stratalux::fit
