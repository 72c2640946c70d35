// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/choose_prior.h"

#include <algorithm>
#include <cmath>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/profile_fit.h"
#include "fitter/mixture/sampled_lights.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

// 1e6: pixels are all alike but for their light.
constexpr double kGrid[] = {0.0, 100.0, 300.0, 1000.0, 3000.0, 1e4, 1e6};

// Fewer tell no N0 from another.
constexpr int64_t kLeastProfiles = 100;
// Enough to tell them; more cost time.
constexpr int64_t kPixels = 512;

// Both in photons; read noise has none.
struct Score {
  double divergence = 0.0, photons = 0.0;
};

// What a fit to other lights predicts of a light: its layers, the mean of its lights' floor and, where it is not
// known, surface.
ProfileFit Prediction(const MixtureMap& map, int64_t profile) {
  ProfileFit fit;
  fit.layers = LayersOf(map, profile);
  fit.tau = map.scattering.tau;
  fit.directional = map.scattering.directional;
  const size_t lights = map.training_projectors.size();
  double surface = 0.0, background = 0.0, lit = 0.0;
  for (size_t p = profile * lights; p < (profile + 1) * lights; ++p) {
    if (!(map.surface[p] > 0.0F) && !(map.background[p] > 0.0F)) continue;
    surface += map.surface[p];
    background += map.background[p];
    lit += 1.0;
  }
  fit.surface = {surface / std::max(lit, 1.0)};
  fit.background = {background / std::max(lit, 1.0)};
  return fit;
}

Score ScoreOf(const MixtureMap& map, const SrdBatch& light, int64_t profile, const EmOptions& options) {
  const ProfileLight left_out = ProfileLightOf(light, profile, options);
  ProfileFit prediction = Prediction(map, profile);
  if (left_out.reflected >= 0.0) prediction.surface = {left_out.reflected};
  Score score;
  score.divergence = MisfitOf(left_out, ModelOf(prediction, FineGrid(left_out), 0)).divergence;
  for (const double y : left_out.y) score.photons += left_out.counts * y;
  return score;
}

// [trial][profile of a light left out]
using Scores = std::vector<std::vector<Score>>;

// One projector left out: what the fits of the others with each N0 make of it, behind `scores`.
Status LeaveOut(int projector, std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                int channels, EmOptions options, Scores& scores) {
  std::vector<const SrdBatch*> training, left_out;
  std::vector<int> names;
  for (size_t p = 0; p < lights.size(); ++p) {
    (projectors[p] == projector ? left_out : training).push_back(lights[p]);
    if (projectors[p] != projector) names.push_back(projectors[p]);
  }
  const int64_t profiles = lights[0]->profiles();
  SLX_ASSIGN_OR_RETURN(const auto mean, MeanLayers(training, channels, options, 1));
  for (size_t trial = 0; trial < std::size(kGrid); ++trial) {
    options.prior.photons = kGrid[trial];
    SLX_ASSIGN_OR_RETURN(
        const auto map, FitMixture(training, names, static_cast<int>(profiles / channels), 1, channels, options, mean));
    const size_t first = scores[trial].size();
    scores[trial].resize(first + profiles * left_out.size());
    ParallelFor(profiles, 16, [&](int64_t begin, int64_t end) {
      for (size_t p = 0; p < left_out.size(); ++p)
        for (int64_t i = begin; i < end; ++i)
          if (map.Fitted(i) && left_out[p]->valid[i] != 0)
            scores[trial][first + p * profiles + i] = ScoreOf(map, *left_out[p], i, options);
    });
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
    if (told < kLeastProfiles) return PriorChoice{choice.prior, {}};
    choice.trials.push_back({kGrid[t], sum.divergence / sum.photons});
  }
  choice.prior.photons = kGrid[WeakestOfTheBest(scores, choice.trials)];
  return choice;
}

}  // namespace stratalux::fit
