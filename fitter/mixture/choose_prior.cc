// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/choose_prior.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/photon_noise.h"
#include "fitter/mixture/sampled_lights.h"

namespace stratalux::fit {
namespace {

// 1e6: pixels are all alike but for their light.
constexpr double kGrid[] = {0.0, 100.0, 300.0, 1000.0, 3000.0, 1e4, 1e6};

// Fewer tell no N0 from another.
constexpr int64_t kLeastJudged = 100;
// Enough to tell them; more cost time.
constexpr int64_t kPixels = 512;

// Both in photons; read noise has none.
struct Score {
  double divergence = 0.0, photons = 0.0;
};

Score ScoreOf(double divergence, const SrdBatch& light, int64_t profile) {
  if (std::isnan(divergence)) return {};
  const auto y = light.Samples(profile);
  return {divergence, PhotonNoiseOf(light, profile).counts * std::accumulate(y.begin(), y.end(), 0.0)};
}

// [trial][profile of a light left out]
using Scores = std::vector<std::vector<Score>>;

// One projector left out: what the fits of the others with each N0 make of it, behind `scores`.
Status LeaveOut(int projector, std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                int channels, const EmOptions& options, Scores& scores) {
  std::vector<const SrdBatch*> training, left_out;
  std::vector<int> names;
  for (size_t p = 0; p < lights.size(); ++p) {
    (projectors[p] == projector ? left_out : training).push_back(lights[p]);
    if (projectors[p] != projector) names.push_back(projectors[p]);
  }
  const int64_t profiles = lights[0]->profiles();
  SLX_ASSIGN_OR_RETURN(const auto mean, MeanLayers(training, channels, options, 1));
  SLX_ASSIGN_OR_RETURN(const auto fits, FitWithPriors(training, names, channels, options, mean, kGrid));
  for (const SrdBatch* light : left_out) {
    const auto divergences = DivergencesFrom(fits, *light, channels, options);
    for (size_t trial = 0; trial < fits.size(); ++trial)
      for (int64_t i = 0; i < profiles; ++i) scores[trial].push_back(ScoreOf(divergences[trial][i], *light, i));
  }
  return Status::Ok();
}

// The weakest prior that these profiles do not tell from the best one: worse by less than a standard error of the
// difference.
size_t WeakestOfTheBest(const Scores& scores, const std::vector<PriorChoice::Trial>& trials) {
  const auto best = std::min_element(trials.begin(), trials.end(),
                                     [](const auto& a, const auto& b) { return a.divergence < b.divergence; }) -
                    trials.begin();
  for (size_t trial = 0; trial < scores.size(); ++trial) {
    double worse = 0.0, squares = 0.0;
    for (size_t i = 0; i < scores[trial].size(); ++i) {
      const double more = scores[trial][i].divergence - scores[best][i].divergence;
      worse += more;
      squares += more * more;
    }
    if (worse <= std::sqrt(squares)) return trial;
  }
  return best;
}

// One usable pixel in so many.
int OneIn(std::span<const SrdBatch* const> lights, int channels) {
  int64_t usable = 0;
  for (int64_t i = 0; i < lights[0]->profiles(); i += channels)
    usable += std::any_of(lights.begin(), lights.end(), [i](const SrdBatch* b) { return b->valid[i] != 0; }) ? 1 : 0;
  return static_cast<int>(std::max<int64_t>(usable / kPixels, 1));
}

}  // namespace

Result<PriorChoice> ChoosePrior(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                int channels, const EmOptions& options) {
  const std::vector<SrdBatch> parts = SampledPixels(lights, channels, OneIn(lights, channels));
  std::vector<const SrdBatch*> sampled;
  for (const SrdBatch& b : parts) sampled.push_back(&b);
  PriorChoice choice{options.prior, {}};
  choice.prior.photons = kUsualPriorPhotons;
  EmOptions trial = options;
  trial.prior = choice.prior;
  std::vector<int> distinct = projectors;
  std::sort(distinct.begin(), distinct.end());
  distinct.erase(std::unique(distinct.begin(), distinct.end()), distinct.end());
  if (distinct.size() < 2) return choice;
  Scores scores(std::size(kGrid));
  for (int projector : distinct) SLX_RETURN_IF_ERROR(LeaveOut(projector, sampled, projectors, channels, trial, scores));
  for (size_t t = 0; t < scores.size(); ++t) {
    Score sum;
    int64_t told = 0;
    for (const Score& score : scores[t]) {
      sum.divergence += score.divergence;
      sum.photons += score.photons;
      told += score.photons > 0.0 ? 1 : 0;
    }
    if (told < kLeastJudged) return PriorChoice{choice.prior, {}};
    choice.trials.push_back({kGrid[t], sum.divergence / sum.photons});
  }
  choice.prior.photons = kGrid[WeakestOfTheBest(scores, choice.trials)];
  return choice;
}

}  // namespace stratalux::fit
