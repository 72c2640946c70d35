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
// Below, EM settles slowest: those are tried only where the weakest of the others may be the best.
constexpr size_t kWeak = 2;
// Standard errors by which a trial must be worse than another for weaker ones to be worse still.
constexpr double kSurely = 3.0;

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

// One projector left out.
struct LeftOut {
  std::vector<const SrdBatch*> training, light;
  std::vector<int> names;  // of the training ones
  std::vector<LayerSet> mean;
};

Result<LeftOut> LeaveOut(int projector, std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                         int channels, const EmOptions& options) {
  LeftOut out;
  for (size_t p = 0; p < lights.size(); ++p) {
    (projectors[p] == projector ? out.light : out.training).push_back(lights[p]);
    if (projectors[p] != projector) out.names.push_back(projectors[p]);
  }
  SLX_ASSIGN_OR_RETURN(out.mean, MeanLayers(out.training, channels, options, 1));
  return out;
}

// What the fits of the others make of each light left out with N0 of kGrid from `first` on, before `end`.
Status Try(size_t first, size_t end, const std::vector<LeftOut>& turns, int channels, const EmOptions& options,
           Scores& scores) {
  for (const LeftOut& turn : turns) {
    SLX_ASSIGN_OR_RETURN(const auto fits, FitWithPriors(turn.training, turn.names, channels, options, turn.mean,
                                                        std::span(kGrid).subspan(first, end - first)));
    for (const SrdBatch* light : turn.light) {
      const auto divergences = DivergencesFrom(fits, *light, channels, options);
      for (size_t trial = first; trial < end; ++trial)
        for (int64_t i = 0; i < light->profiles(); ++i)
          scores[trial].push_back(ScoreOf(divergences[trial - first][i], *light, i));
    }
  }
  return Status::Ok();
}

double DivergenceOf(const std::vector<Score>& scores) {
  return std::accumulate(scores.begin(), scores.end(), 0.0,
                         [](double sum, const Score& s) { return sum + s.divergence; });
}

// Whether a trial is worse than another by more than so many standard errors of the difference.
bool IsWorse(const std::vector<Score>& trial, const std::vector<Score>& other, double standard_errors) {
  double worse = 0.0, squares = 0.0;
  for (size_t i = 0; i < trial.size(); ++i) {
    const double more = trial[i].divergence - other[i].divergence;
    worse += more;
    squares += more * more;
  }
  return worse > standard_errors * std::sqrt(squares);
}

size_t BestOf(const Scores& scores, size_t first) {
  size_t best = first;
  for (size_t trial = first; trial < scores.size(); ++trial)
    if (DivergenceOf(scores[trial]) < DivergenceOf(scores[best])) best = trial;
  return best;
}

// One usable pixel in so many.
int OneIn(std::span<const SrdBatch* const> lights, int channels) {
  int64_t usable = 0;
  for (int64_t i = 0; i < lights[0]->profiles(); i += channels)
    usable += std::any_of(lights.begin(), lights.end(), [i](const SrdBatch* b) { return b->Shares(i); }) ? 1 : 0;
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
  std::vector<LeftOut> turns;
  for (int projector : distinct) {
    SLX_ASSIGN_OR_RETURN(auto turn, LeaveOut(projector, sampled, projectors, channels, trial));
    turns.push_back(std::move(turn));
  }
  Scores scores(std::size(kGrid));
  SLX_RETURN_IF_ERROR(Try(kWeak, scores.size(), turns, channels, trial, scores));
  const auto told = std::ranges::count_if(scores[kWeak], [](const Score& s) { return s.photons > 0.0; });
  if (told < kLeastJudged) return choice;
  size_t first = kWeak;
  if (!IsWorse(scores[first], scores[BestOf(scores, first)], kSurely)) {
    SLX_RETURN_IF_ERROR(Try(0, kWeak, turns, channels, trial, scores));
    first = 0;
  }
  const size_t best = BestOf(scores, first);
  bool chosen = false;
  for (size_t t = first; t < scores.size(); ++t) {
    const double photons = std::accumulate(scores[t].begin(), scores[t].end(), 0.0,
                                           [](double sum, const Score& s) { return sum + s.photons; });
    choice.trials.push_back({kGrid[t], DivergenceOf(scores[t]) / photons});
    // The weakest that these profiles do not tell from the best.
    if (chosen || IsWorse(scores[t], scores[best], 1.0)) continue;
    choice.prior.photons = kGrid[t];
    chosen = true;
  }
  return choice;
}

}  // namespace stratalux::fit
