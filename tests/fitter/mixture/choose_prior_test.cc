// SPDX-License-Identifier: Apache-2.0
// The prior chosen by the lights left out: what it is worth for pixels of few and of many photons.
#include "fitter/mixture/choose_prior.h"

#include <cmath>
#include <cstdlib>

#include <gtest/gtest.h>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/mean_layers.h"
#include "tests/fitter/mixture/em_cases.h"

namespace stratalux::fit {
namespace {

constexpr int kProfiles = 256;
const std::vector<int> kProjectors = {0, 1, 2};

// Neighbouring pixels: one skin, each layer of each pixel up to a fifth off in weight, depth and width.
EmCases Neighbours(double peak_counts, uint64_t seed) {
  return MakeEmCases({.profiles = kProfiles, .peak_counts = peak_counts, .read_photons = 25.0, .alike = kProfiles}, {},
                     seed);
}

Result<PriorChoice> Choose(const EmCases& made, const EmOptions& options,
                           const std::vector<int>& projectors = kProjectors) {
  SLX_ASSIGN_OR_RETURN(const LeftOutLights left, LeaveOutEach(made.lights(), projectors, 1, options));
  return ChoosePrior(left, options);
}

LayerPrior Chosen(const EmCases& made, const EmOptions& options) {
  const auto choice = Choose(made, options);
  EXPECT_TRUE(choice.ok()) << choice.status().message();
  EXPECT_FALSE(choice->trials.empty());
  return choice->prior;
}

MixtureMap Fit(const EmCases& made, EmOptions options, const LayerPrior& prior) {
  options.prior = prior;
  const auto mean = MeanLayers(made.lights(), 1, options);
  EXPECT_TRUE(mean.ok());
  auto map = FitMixture(made.lights(), kProjectors, kProfiles, 1, 1, options, *mean);
  EXPECT_TRUE(map.ok());
  return *std::move(map);
}

TEST(ChoosePrior, ServesWeakPixelsAndCostsStrongOnesNothing) {
  const EmOptions options;
  for (const auto& [counts, worth] : {std::pair(100.0, 0.8), {400.0, 0.95}, {4000.0, 1.0}}) {
    const EmCases made = Neighbours(counts, 41);
    const LayerPrior prior = Chosen(made, options);
    const double with = ShapeError(made, Fit(made, options, prior), options),
                 without = ShapeError(made, Fit(made, options, {}), options);
    EXPECT_LT(with, worth * without) << counts << " counts, N0 = " << prior.photons;
  }
}

TEST(ChoosePrior, BindsPixelsThatAreAlikeMoreThanThoseThatAreNot) {
  const EmOptions options;
  const EmCases alike = Neighbours(400.0, 42);
  const EmCases unlike = MakeEmCases({.profiles = kProfiles, .peak_counts = 400.0, .alike = 1}, options, 42);
  EXPECT_LT(3.0 * Chosen(unlike, options).photons, Chosen(alike, options).photons);
}

TEST(ChoosePrior, TriesWeakPriorsOnlyWhereOneMayBeTheBest) {
  const EmOptions options;
  // Enough photons to tell how much alike the pixels are; of those that are, a strong one is the best.
  const auto choose = [&](int alike) {
    const EmCases made =
        MakeEmCases({.profiles = kProfiles, .peak_counts = 2e4, .alike = alike, .unlike = 0.1}, options, 50);
    auto choice = Choose(made, options);
    EXPECT_TRUE(choice.ok() && !choice->trials.empty());
    return *std::move(choice);
  };
  const PriorChoice alike = choose(kProfiles), unlike = choose(1);
  EXPECT_EQ(alike.trials.front().photons, 300.0);
  EXPECT_GT(alike.prior.photons, 300.0);
  EXPECT_EQ(unlike.trials.front().photons, 0.0);
  EXPECT_LT(unlike.prior.photons, 300.0);
}

// Divergence of each profile of each light left out in turn, of fits with `photons`.
std::vector<double> LeftOutDivergences(const EmCases& made, const LeftOutLights& left, const EmOptions& options,
                                       double photons) {
  std::vector<double> divergences;
  for (const LeftOut& turn : left.turns) {
    const double trial[] = {photons};
    const auto lights = made.lights();
    const auto fits = FitWithPriors(At(lights, turn.training), turn.names, 1, options, turn.mean, trial);
    EXPECT_TRUE(fits.ok());
    for (const SrdBatch* light : At(lights, turn.left_out)) {
      const auto of_light = DivergencesFrom(*fits, *light, 1, options);
      divergences.insert(divergences.end(), of_light[0].begin(), of_light[0].end());
    }
  }
  return divergences;
}

TEST(ChoosePrior, IsNoWorseThanAnyOfTheGridByMoreThanItsStandardError) {
  EmOptions options;
  options.prior.photons = kUsualPriorPhotons;
  for (const int alike : {1, 8, kProfiles}) {
    const EmCases made =
        MakeEmCases({.profiles = kProfiles, .peak_counts = 1000.0, .alike = alike}, options, 60 + alike);
    const auto left = LeaveOutEach(made.lights(), kProjectors, 1, options);
    ASSERT_TRUE(left.ok());
    const auto choice = ChoosePrior(*left, options);
    ASSERT_TRUE(choice.ok() && !choice->trials.empty());
    const auto chosen = LeftOutDivergences(made, *left, options, choice->prior.photons);
    for (const double photons : {0.0, 100.0, 300.0, 1000.0, 3000.0, 1e4, 1e6}) {
      const auto other = LeftOutDivergences(made, *left, options, photons);
      double worse = 0.0, squares = 0.0;
      for (size_t i = 0; i < other.size(); ++i) {
        worse += chosen[i] - other[i];
        squares += std::pow(chosen[i] - other[i], 2);
      }
      EXPECT_LE(worse, std::sqrt(squares)) << choice->prior.photons << " for " << photons << ", alike " << alike;
    }
  }
}

TEST(ChoosePrior, HearsNothingOfLightsThatNoFitCanUse) {
  // Samples that are no number; light from behind the horizon, as of directions given to the wrong light.
  const EmOptions options;
  EmCases made = Neighbours(400.0, 44);
  const double without = Chosen(made, options).photons;
  made.batches[1].Samples(7)[3] = std::nanf("");
  made.batches[2].cos_in[9] = 0.0F;
  const auto choice = Choose(made, options);
  ASSERT_TRUE(choice.ok());
  for (const auto& trial : choice->trials) EXPECT_TRUE(std::isfinite(trial.divergence)) << trial.photons;
  EXPECT_EQ(choice->prior.photons, without);
}

TEST(FitWithPriors, FindsTheLayersOfOneFitEach) {
  EmOptions options;
  options.tolerance = 3e-4;  // some lanes settle early, so that trials of several profiles meet in a block
  EmCases made = MakeEmCases({.profiles = 40, .peak_counts = 400.0, .alike = 8}, options, 45);
  made.batches[1].valid[3] = 0;                             // a light that one profile lacks
  for (SrdBatch& light : made.batches) light.valid[5] = 0;  // and a profile that none lights
  const auto mean = MeanLayers(made.lights(), 1, options);
  ASSERT_TRUE(mean.ok());
  const std::vector<double> photons = {300.0, 0.0, 1e6, 300.0};
  const auto fits = FitWithPriors(made.lights(), kProjectors, 1, options, *mean, photons);
  ASSERT_TRUE(fits.ok()) << fits.status().message();
  ASSERT_EQ(fits->size(), photons.size());
  for (size_t trial = 0; trial < photons.size(); ++trial) {
    options.prior.photons = photons[trial];
    const auto alone = FitMixture(made.lights(), kProjectors, 40, 1, 1, options, *mean);
    ASSERT_TRUE(alone.ok());
    const MixtureMap& shared = (*fits)[trial];
    for (const auto field : {&MixtureMap::weight, &MixtureMap::depth_mm, &MixtureMap::sigma_mm, &MixtureMap::surface,
                             &MixtureMap::background})
      EXPECT_EQ(shared.*field, (*alone).*field) << "N0 = " << photons[trial];
    EXPECT_EQ(shared.reason, alone->reason);
  }
  EXPECT_NE((*fits)[0].weight, (*fits)[1].weight);
  EXPECT_NE((*fits)[0].weight, (*fits)[2].weight);
}

TEST(ChoosePrior, IsTheSameForAnyNumberOfThreadsAndTheUsualOneWhereNoLightCanBeLeftOut) {
  const EmOptions options;
  EmCases made = MakeEmCases({.profiles = 40, .peak_counts = 200.0, .alike = 40}, options, 43);
  setenv("STRATALUX_THREADS", "1", 1);
  const auto one = Choose(made, options);
  setenv("STRATALUX_THREADS", "3", 1);
  const auto three = Choose(made, options);
  unsetenv("STRATALUX_THREADS");
  ASSERT_TRUE(one.ok() && three.ok());
  ASSERT_EQ(one->trials.size(), three->trials.size());
  for (size_t t = 0; t < one->trials.size(); ++t) EXPECT_EQ(one->trials[t].divergence, three->trials[t].divergence);
  EXPECT_EQ(one->prior.photons, three->prior.photons);

  // Three sweeps of one projector are one light.
  const auto alone = Choose(made, options, {2, 2, 2});
  ASSERT_TRUE(alone.ok());
  EXPECT_EQ(alone->prior.photons, kUsualPriorPhotons);
  EXPECT_TRUE(alone->trials.empty());
}

}  // namespace
}  // namespace stratalux::fit
