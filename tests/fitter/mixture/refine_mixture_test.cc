// SPDX-License-Identifier: Apache-2.0
// A map of three lights refined by four: where it ends, what it leaves alone, and how many sweeps it takes.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numeric>

#include <gtest/gtest.h>

#include "fitter/mixture/warm_start.h"
#include "tests/fitter/mixture/em_cases.h"
#include "tests/fitter/mixture/reference_em.h"

namespace stratalux::fit {
namespace {

constexpr int kProfiles = 96;
const std::vector<int> kAll = {0, 1, 2, 3}, kThree = {0, 1, 2};

// One skin in a little variety, as neighbouring pixels are, under four lights.
EmCases FourLights(double peak_counts, uint64_t seed) {
  return MakeEmCases(
      {.profiles = kProfiles, .peak_counts = peak_counts, .alike = kProfiles, .slopes = {-1.0, 0.0, 0.58, 1.0}}, {},
      seed);
}

std::vector<const SrdBatch*> First(const EmCases& made, size_t lights) {
  auto all = made.lights();
  all.resize(lights);
  return all;
}

EmOptions WithPrior(double photons = 1000.0) {
  EmOptions options;
  options.prior.photons = photons;
  return options;
}

std::vector<LayerSet> MeanOf(const std::vector<const SrdBatch*>& lights, const EmOptions& options) {
  const auto mean = MeanLayers(lights, 1, options, 4);
  EXPECT_TRUE(mean.ok()) << mean.status().message();
  return *mean;
}

MixtureMap FitOfThree(const EmCases& made, const EmOptions& options) {
  const auto lights = First(made, 3);
  auto map = FitMixture(lights, kThree, kProfiles, 1, 1, options, MeanOf(lights, options));
  EXPECT_TRUE(map.ok()) << map.status().message();
  return *std::move(map);
}

RefinedMap Refine(const EmCases& made, const MixtureMap& fit, int sweeps, const EmOptions& options) {
  auto refined = RefineMixture(made.lights(), kAll, fit, sweeps, options, MeanOf(made.lights(), options));
  EXPECT_TRUE(refined.ok()) << refined.status().message();
  return *std::move(refined);
}

MixtureMap FitOfFour(const EmCases& made, EmOptions options, int sweeps) {
  options.refinement_iterations = sweeps;
  auto map = FitMixture(made.lights(), kAll, kProfiles, 1, 1, options, MeanOf(made.lights(), options));
  EXPECT_TRUE(map.ok()) << map.status().message();
  return *std::move(map);
}

double Total(const MixtureMap& map, int64_t i) {
  const auto layers = LayersOf(map, i);
  return std::accumulate(layers.weight.begin(), layers.weight.end(), 0.0);
}
double MeanDepth(const MixtureMap& map, int64_t i) {
  const auto layers = LayersOf(map, i);
  return std::inner_product(layers.weight.begin(), layers.weight.end(), layers.depth_mm.begin(), 0.0) / Total(map, i);
}

void ExpectSameProfile(const MixtureMap& a, const MixtureMap& b, int64_t i) {
  for (const auto field : {&MixtureMap::weight, &MixtureMap::depth_mm, &MixtureMap::sigma_mm})
    for (int64_t at = i * a.layers; at < (i + 1) * a.layers; ++at) EXPECT_EQ((a.*field)[at], (b.*field)[at]) << i;
  EXPECT_EQ(a.divergence[i], b.divergence[i]) << i;
  EXPECT_EQ(a.iterations[i], b.iterations[i]) << i;
  EXPECT_EQ(a.reason[i], b.reason[i]) << i;
  EXPECT_EQ(a.prior_share[i], b.prior_share[i]) << i;
}

// The posterior has its maximum where it has it, whatever EM starts from.
TEST(RefineMixture, EndsWhereAColdStartOfAllLightsEnds) {
  EmOptions options = WithPrior();
  options.tolerance = 0.0;
  const EmCases made = FourLights(1000.0, 71);
  const MixtureMap fit = FitOfThree(made, options), cold = FitOfFour(made, options, 400);
  const RefinedMap warm = Refine(made, fit, 400, options);
  EXPECT_EQ(warm.refined, kProfiles);
  for (int64_t i = 0; i < kProfiles; ++i) {
    EXPECT_NEAR(warm.map.divergence[i] / cold.divergence[i], 1.0, 2e-3) << i;
    EXPECT_NEAR(Total(warm.map, i) / Total(cold, i), 1.0, 2e-3) << i;
    EXPECT_NEAR(MeanDepth(warm.map, i), MeanDepth(cold, i), 0.01) << i;
    EXPECT_NEAR(warm.map.prior_share[i], cold.prior_share[i], 1e-6) << i;
  }
}

// By the reference in double precision: the cost of a refinement is that of its layers under the prior of the mean
// layers, not under one that took its shares from the layers that EM started from.
TEST(RefineMixture, CostIsThePosteriorsOfTheMeanLayersPrior) {
  const EmOptions options = WithPrior(3000.0);
  const EmCases made = FourLights(400.0, 72);
  const std::vector<LayerSet> mean = MeanOf(made.lights(), options);
  const RefinedMap warm = Refine(made, FitOfThree(made, options), 3, options);
  // The known pixel: what a start from the mean layers holds before its first sweep.
  const MixtureMap centre = FitOfFour(made, options, 0);
  const auto fit_of = [&](const MixtureMap& map, int64_t i) {
    ProfileFit fit;
    fit.layers = LayersOf(map, i);
    fit.surface.assign(map.surface.begin() + i * 4, map.surface.begin() + (i + 1) * 4);
    fit.background.assign(4, 0.0);
    return fit;
  };
  int judged = 0;
  for (int64_t i = 0; i < kProfiles; i += 12) {
    std::vector<ProfileLight> lights;
    double photons = 0.0;
    for (const SrdBatch& light : made.batches) {
      lights.push_back(ProfileLightOf(light, i, options));
      for (const double y : lights.back().y)
        photons += lights.back().counts * std::max(y + lights.back().read_shift, 0.0);
    }
    // Neither map was scaled to white frames: there are none.
    const double nats = photons * PenalisedDivergence(lights, fit_of(centre, i), fit_of(warm.map, i), options);
    EXPECT_NEAR(warm.cost[i] / nats, 1.0, 2e-3) << i;
    ++judged;
  }
  EXPECT_EQ(judged, 8);
}

TEST(RefineMixture, LeavesWhatTheFourthLightDoesNotReachAndFitsWhatOnlyItReaches) {
  const EmOptions options = WithPrior();
  EmCases made = FourLights(1000.0, 73);
  made.batches[3].valid[4] = 0;                                 // in its shadow
  made.batches[3].Samples(5)[7] = std::nanf("");                // masked, counted
  made.batches[3].cos_in[6] = -0.2F;                            // behind the horizon, counted
  for (size_t p = 0; p < 3; ++p) made.batches[p].valid[7] = 0;  // only the fourth reaches it
  for (SrdBatch& light : made.batches) light.valid[8] = 0;      // none does
  made.batches[1].valid[9] = 0;                                 // two and the fourth
  const MixtureMap fit = FitOfThree(made, options);
  EXPECT_FALSE(fit.Fitted(7));
  const RefinedMap warm = Refine(made, fit, 3, options);
  EXPECT_EQ(warm.kept, 3);
  EXPECT_EQ(warm.unusable, 2);
  EXPECT_EQ(warm.added, 1);
  EXPECT_EQ(warm.refined, kProfiles - 5);
  EXPECT_EQ(warm.map.training_projectors, kAll);
  for (const int64_t i : {4, 5, 6}) {
    ExpectSameProfile(warm.map, fit, i);
    for (size_t p = 0; p < 3; ++p) EXPECT_EQ(warm.map.surface[i * 4 + p], fit.surface[i * 3 + p]) << i;
    EXPECT_EQ(warm.map.surface[i * 4 + 3], 0.0F) << "a light that it was not fitted to";
    EXPECT_TRUE(std::isnan(warm.cost[i]));
  }
  EXPECT_TRUE(warm.map.Fitted(7));
  EXPECT_GT(Total(warm.map, 7), 0.0);
  ExpectSameProfile(warm.map, FitOfFour(made, options, options.refinement_iterations), 7);
  EXPECT_FALSE(warm.map.Fitted(8));
  EXPECT_EQ(Total(warm.map, 8), 0.0);
  for (int64_t i = 0; i < kProfiles; ++i)
    for (const auto field : {&MixtureMap::weight, &MixtureMap::depth_mm, &MixtureMap::sigma_mm})
      for (int64_t at = i * fit.layers; at < (i + 1) * fit.layers; ++at)
        EXPECT_TRUE(std::isfinite((warm.map.*field)[at])) << i;
}

TEST(RefineMixture, IsTheSameForAnyNumberOfThreadsAndRefusesLightsOfAnotherOrder) {
  const EmOptions options = WithPrior();
  const EmCases made = FourLights(400.0, 74);
  const MixtureMap fit = FitOfThree(made, options);
  setenv("STRATALUX_THREADS", "1", 1);
  const RefinedMap one = Refine(made, fit, 4, options);
  setenv("STRATALUX_THREADS", "3", 1);
  const RefinedMap three = Refine(made, fit, 4, options);
  unsetenv("STRATALUX_THREADS");
  EXPECT_EQ(one.map.weight, three.map.weight);
  EXPECT_EQ(one.map.sigma_mm, three.map.sigma_mm);
  const auto wrong = RefineMixture(made.lights(), {1, 0, 2, 3}, fit, 4, options);
  ASSERT_FALSE(wrong.ok());
  EXPECT_EQ(wrong.status().code(), StatusCode::kUsage);
}

TEST(RefineMixture, WithoutPriorGoesOnFromTheFitToo) {
  const EmOptions options = WithPrior(0.0);
  const EmCases made = FourLights(4000.0, 75);
  auto fit = FitMixture(First(made, 3), kThree, kProfiles, 1, 1, options);
  ASSERT_TRUE(fit.ok());
  const auto warm = RefineMixture(made.lights(), kAll, *fit, 3, options);
  ASSERT_TRUE(warm.ok());
  for (int64_t i = 0; i < kProfiles; ++i) EXPECT_EQ(warm->map.iterations[i], 3);
}

// Traced sweeps cost what as many cost by themselves, bit for bit, of profiles that settle early, too, from layers and
// from nothing; and whoever is traced ends where nobody looks.
TEST(RefineMixture, TracedSweepsCostWhatAsManyCost) {
  EmOptions options = WithPrior(300.0);
  options.tolerance = 1e-3;  // some settle at the second look
  const EmCases made = FourLights(4000.0, 82);
  const std::vector<LayerSet> mean = MeanOf(made.lights(), options);
  constexpr int kMost = 30, kTraced = 24;
  for (const MixtureMap& start : {FitOfThree(made, options), UnfittedMap(kProfiles, 1, 1, options)}) {
    const auto refine = [&](int sweeps, int traced) {
      EmOptions few = options;
      few.refinement_iterations = sweeps;
      auto refined = RefineMixture(made.lights(), kAll, start, sweeps, few, mean, {}, traced);
      EXPECT_TRUE(refined.ok()) << refined.status().message();
      return *std::move(refined);
    };
    const RefinedMap traced = refine(kMost, kTraced), silent = refine(kMost, 0);
    EXPECT_TRUE(silent.cost_after.empty());
    ASSERT_EQ(traced.cost_after.size(), size_t{kProfiles} * kTraced);
    EXPECT_EQ(traced.cost, silent.cost);
    for (int64_t i = 0; i < kProfiles; ++i) ExpectSameProfile(traced.map, silent.map, i);
    const auto [least, most] = std::ranges::minmax(traced.map.iterations);
    EXPECT_LT(least, kTraced);
    EXPECT_GT(most, kTraced);
    for (int sweeps = 1; sweeps <= kTraced; ++sweeps) {
      const RefinedMap few = refine(sweeps, 0);
      for (size_t i = 0; i < kProfiles; ++i)
        EXPECT_EQ(traced.cost_after[i * kTraced + static_cast<size_t>(sweeps) - 1], few.cost[i]) << i << ", " << sweeps;
    }
  }
}

// What the choice says of a start with so many sweeps holds for pixels that it has not seen.
TEST(ChooseWarmSweeps, IsTheFewestThatTheRefereeCannotTellFromItsOwn) {
  const EmOptions options = WithPrior();
  const EmCases made = FourLights(400.0, 76);
  const std::vector<LayerSet> mean = MeanOf(made.lights(), options);
  const MixtureMap fit = FitOfThree(made, options);
  const auto choice = ChooseWarmSweeps(made.lights(), kAll, fit, options, mean);
  ASSERT_TRUE(choice.ok()) << choice.status().message();
  ASSERT_TRUE(choice->Reached());
  EXPECT_EQ(choice->profiles, kProfiles);
  ASSERT_EQ(static_cast<int>(choice->trials.size()), choice->sweeps);
  for (size_t t = 0; t + 1 < choice->trials.size(); ++t) {
    EXPECT_GT(choice->trials[t].excess_nats, kWarmToleranceNats);
    EXPECT_LT(choice->trials[t + 1].excess_nats, choice->trials[t].excess_nats);
  }
  EXPECT_LT(choice->sweeps, options.refinement_iterations);
  // The numbers are those of the sweeps themselves: run to the end that was chosen, and far beyond it.
  EmOptions endless = options;
  endless.tolerance = 0.0;
  const RefinedMap warm = Refine(made, fit, choice->sweeps, options), end = Refine(made, fit, 300, endless);
  double above = 0.0;
  for (int64_t i = 0; i < kProfiles; ++i) above += (double(warm.cost[i]) - double(end.cost[i])) / kProfiles;
  EXPECT_NEAR(above, choice->trials.back().excess_nats, 5e-3);
  // One sweep from the layers of three lights is worth more than one from the mean of all pixels.
  EXPECT_LT(choice->trials[0].excess_nats, choice->trials[0].cold_excess_nats);
}

// Of a fit that is far from what all lights say (here: of another skin) more sweeps are asked for.
TEST(ChooseWarmSweeps, AsksForMoreOfAWorseStart) {
  EmOptions options = WithPrior();
  options.refinement_iterations = 60;
  const EmCases made = FourLights(400.0, 77);
  const std::vector<LayerSet> mean = MeanOf(made.lights(), options);
  const MixtureMap fit = FitOfThree(made, options);
  MixtureMap spoilt = fit;
  for (float& depth : spoilt.depth_mm) depth = 1.0F;
  for (float& sigma : spoilt.sigma_mm) sigma *= 2.0F;
  const auto good = ChooseWarmSweeps(made.lights(), kAll, fit, options, mean),
             bad = ChooseWarmSweeps(made.lights(), kAll, spoilt, options, mean);
  ASSERT_TRUE(good.ok() && bad.ok());
  EXPECT_GT(bad->sweeps, good->sweeps);
}

TEST(ChooseWarmSweeps, HasNothingToTryWhereNoFurtherLightReaches) {
  const EmOptions options = WithPrior();
  EmCases made = FourLights(400.0, 78);
  const MixtureMap fit = FitOfThree(made, options);
  for (float& y : made.batches[3].y) y = std::nanf("");
  auto choice = ChooseWarmSweeps(made.lights(), kAll, fit, options, MeanOf(made.lights(), options));
  ASSERT_TRUE(choice.ok());
  EXPECT_EQ(choice->profiles, 0);
  std::ranges::fill(made.batches[3].valid, uint8_t{0});
  choice = ChooseWarmSweeps(made.lights(), kAll, fit, options, MeanOf(made.lights(), options));
  ASSERT_TRUE(choice.ok());
  EXPECT_EQ(choice->profiles, 0);
  EXPECT_EQ(Refine(made, fit, std::max(choice->sweeps, 1), options).kept, kProfiles);
}

// A fit from the mean layers ends where data could not tell it from EM that has settled, of pixels that were not
// sampled too: seen here by the sweeps themselves, run to the end that was chosen and far beyond it.
TEST(ChooseSweeps, IsTheFewestThatDataCannotTellFromEmThatHasSettled) {
  const EmOptions options = WithPrior();
  const EmCases made = FourLights(400.0, 79);
  const auto choice = ChooseSweeps(made.lights(), kAll, 1, options, MeanOf(made.lights(), options));
  ASSERT_TRUE(choice.ok()) << choice.status().message();
  ASSERT_TRUE(choice->Reached());
  EXPECT_EQ(choice->profiles, kProfiles);
  EXPECT_GT(choice->referee_sweeps, choice->sweeps);
  ASSERT_EQ(static_cast<int>(choice->trials.size()), choice->sweeps);
  for (size_t t = 0; t + 1 < choice->trials.size(); ++t) EXPECT_GT(choice->trials[t].excess_nats, kWarmToleranceNats);
  // A refinement of nothing is a fit, and says what it cost.
  MixtureMap nothing = FitOfFour(made, options, 0);
  nothing.training_projectors.clear();
  nothing.surface.clear();
  nothing.background.clear();
  std::ranges::fill(nothing.reason, static_cast<uint8_t>(FitReason::kNoProjector));
  EmOptions few = options, endless = options;
  few.refinement_iterations = choice->sweeps;
  endless.refinement_iterations = 300;
  endless.tolerance = 0.0;
  const RefinedMap fit = Refine(made, nothing, 0, few), end = Refine(made, nothing, 0, endless);
  const MixtureMap same = FitOfFour(made, options, choice->sweeps);
  double above = 0.0;
  for (int64_t i = 0; i < kProfiles; ++i) {
    above += (double(fit.cost[i]) - double(end.cost[i])) / kProfiles;
    ExpectSameProfile(fit.map, same, i);
  }
  EXPECT_NEAR(above, choice->trials.back().excess_nats, 5e-3);
}

// The less the mean layers count, the further is the way from them; and never more sweeps than are allowed.
TEST(ChooseSweeps, AsksForMoreWhereThePriorIsWeak) {
  EmOptions weak = WithPrior(30.0), strong = WithPrior(3000.0);
  weak.refinement_iterations = strong.refinement_iterations = 60;
  const EmCases made = FourLights(4000.0, 80);
  const std::vector<LayerSet> mean = MeanOf(made.lights(), weak);
  const auto far = ChooseSweeps(made.lights(), kAll, 1, weak, mean),
             near = ChooseSweeps(made.lights(), kAll, 1, strong, mean);
  ASSERT_TRUE(far.ok() && near.ok());
  EXPECT_GT(far->sweeps, near->sweeps);
  weak.refinement_iterations = 2;
  const auto cut = ChooseSweeps(made.lights(), kAll, 1, weak, mean);
  ASSERT_TRUE(cut.ok());
  EXPECT_EQ(cut->sweeps, 2);
  EXPECT_FALSE(cut->Reached());
}

TEST(ChooseSweeps, HasNothingToTryWhereNothingIsLit) {
  const EmOptions options = WithPrior();
  EmCases made = FourLights(400.0, 81);
  const std::vector<LayerSet> mean = MeanOf(made.lights(), options);
  for (SrdBatch& batch : made.batches) std::ranges::fill(batch.valid, uint8_t{0});
  const auto choice = ChooseSweeps(made.lights(), kAll, 1, options, mean);
  ASSERT_TRUE(choice.ok());
  EXPECT_EQ(choice->profiles, 0);
  EXPECT_EQ(choice->sweeps, 0);
}

}  // namespace
}  // namespace stratalux::fit
