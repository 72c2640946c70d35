// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/choose_prior.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/sampled_lights.h"
#include "shared/base/parallel_each.h"

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

// Of N0 of the session's, photons of a prior centred on neighbours, which know a pixel better.
constexpr double kNeighboursGrid[] = {1.0, 3.0, 10.0, 30.0};
// Places whose neighbourhoods are judged, and how much of each around its middle; a margin beside it has neighbours.
constexpr size_t kPlaces = 12;
constexpr double kTrimmed = 0.1;  // of the profiles on either side
constexpr double kJudgedMm = 3.0, kMarginMm = 6.0;

// [trial]
using Scores = std::vector<LeftOutScores>;

void AddScores(std::span<const MixtureMap> fits, const SrdBatch& light, int channels, const EmOptions& options,
               std::span<LeftOutScores> scores) {
  const auto divergences = DivergencesFrom(fits, light, channels, options);
  for (size_t trial = 0; trial < fits.size(); ++trial)
    for (int64_t i = 0; i < light.profiles(); ++i) scores[trial].push_back(ScoreOf(divergences[trial][i], light, i));
}

// What the fits of the others make of each light left out with N0 of kGrid from `first` on, before `end`.
Status Try(size_t first, size_t end, const LeftOutLights& left, const EmOptions& options, Scores& scores) {
  const auto sampled = PointersTo(left.sampled);
  for (const LeftOut& turn : left.turns) {
    SLX_ASSIGN_OR_RETURN(const auto fits, FitWithPriors(At(sampled, turn.training), turn.names, left.channels, options,
                                                        turn.mean, std::span(kGrid).subspan(first, end - first)));
    for (const SrdBatch* light : At(sampled, turn.left_out))
      AddScores(fits, *light, left.channels, options, std::span(scores).subspan(first, end - first));
  }
  return Status::Ok();
}

size_t BestOf(const Scores& scores, size_t first) {
  size_t best = first;
  for (size_t trial = first; trial < scores.size(); ++trial)
    if (DivergenceOf(scores[trial]) < DivergenceOf(scores[best])) best = trial;
  return best;
}

// Mean divergence of a trial above that of another, of the middle profiles by that difference.
double MoreThan(const LeftOutScores& other, const LeftOutScores& trial) {
  std::vector<double> more;
  for (size_t i = 0; i < trial.size(); ++i)
    if (other[i].photons > 0.0) more.push_back(trial[i].divergence - other[i].divergence);
  std::sort(more.begin(), more.end());
  const auto trimmed = static_cast<std::ptrdiff_t>(kTrimmed * static_cast<double>(more.size()));
  return std::accumulate(more.begin() + trimmed, more.end() - trimmed, 0.0) /
         static_cast<double>(std::ssize(more) - 2 * trimmed);
}

// Pixels around a place: all of them, and those of skin that are judged, by their number among all.
struct Patch {
  int width = 0, height = 0;
  std::vector<int64_t> profiles, judged;
};

Patch PatchAround(std::span<const SrdBatch* const> lights, int64_t pixel, int width, int height, int channels,
                  double spacing_mm) {
  const auto reach = [&](double mm) { return std::max(static_cast<int>(std::lround(mm / spacing_mm)), 1); };
  const int inner = reach(kJudgedMm), outer = inner + reach(kMarginMm);
  const int x = static_cast<int>(pixel % width), y = static_cast<int>(pixel / width);
  const int left = std::max(x - outer, 0), right = std::min(x + outer, width - 1);
  const int top = std::max(y - outer, 0), bottom = std::min(y + outer, height - 1);
  Patch patch{right - left + 1, bottom - top + 1, {}, {}};
  for (int j = top; j <= bottom; ++j)
    for (int i = left; i <= right; ++i)
      for (int c = 0; c < channels; ++c) {
        const int64_t profile = (int64_t{j} * width + i) * channels + c;
        if (std::abs(i - x) <= inner && std::abs(j - y) <= inner && !lights[0]->IsApart(profile))
          patch.judged.push_back(std::ssize(patch.profiles));
        patch.profiles.push_back(profile);
      }
  return patch;
}

// Around kPlaces pixels of skin that two projectors show, evenly among those; all that there are where they are fewer.
std::vector<Patch> PatchesOf(std::span<const SrdBatch* const> lights, const LeftOutLights& left, int width, int height,
                             double spacing_mm) {
  const auto by_two = [&](int64_t i) {
    int shown_by = -1;
    for (size_t p = 0; p < lights.size(); ++p) {
      if (!lights[p]->Shares(i)) continue;
      if (shown_by >= 0 && left.projectors[p] != shown_by) return true;
      shown_by = left.projectors[p];
    }
    return false;
  };
  std::vector<int64_t> shown;
  for (int64_t i = 0; i < lights[0]->profiles(); i += left.channels)
    if (by_two(i)) shown.push_back(i / left.channels);
  const size_t places = std::min(kPlaces, shown.size());
  std::vector<Patch> patches;
  for (size_t k = 0; k < places; ++k)
    patches.push_back(PatchAround(lights, shown[(k * 2 + 1) * shown.size() / (2 * places)], width, height,
                                  left.channels, spacing_mm));
  return patches;
}

// [trial]: of the session's mean with N0, then of the neighbours' with each of `photons`.
Result<Scores> TryNeighbours(const Patch& patch, std::span<const SrdBatch* const> lights, const LeftOut& turn,
                             int channels, const EmOptions& options, double spacing_mm,
                             std::span<const double> photons) {
  const SampledBatches all(lights, patch.profiles);
  const auto training = At(all.batches(), turn.training);
  SLX_ASSIGN_OR_RETURN(const ProfileLayers around, FitNeighbours(training, turn.names, patch.width, patch.height,
                                                                 channels, options, turn.mean, spacing_mm));
  const ProfileLayers near = ProfilesOf(around, patch.judged);
  const SampledBatches judged(all.batches(), patch.judged);
  const auto seen = At(judged.batches(), turn.training);
  const double session[] = {options.prior.photons};
  SLX_ASSIGN_OR_RETURN(const auto of_session, FitWithPriors(seen, turn.names, channels, options, turn.mean, session));
  SLX_ASSIGN_OR_RETURN(const auto of_near, FitWithPriors(seen, turn.names, channels, options,
                                                         {turn.mean, &near, options.prior.photons}, photons));
  Scores scores(1 + photons.size());
  for (const SrdBatch* light : At(judged.batches(), turn.left_out)) {
    AddScores(of_session, *light, channels, options, std::span(scores).first(1));
    AddScores(of_near, *light, channels, options, std::span(scores).subspan(1));
  }
  return scores;
}

}  // namespace

Result<PriorChoice> ChoosePrior(const LeftOutLights& left, const EmOptions& options) {
  PriorChoice choice{options.prior, {}};
  choice.prior.photons = kUsualPriorPhotons;
  if (left.turns.empty()) return choice;
  EmOptions trial = options;
  trial.prior = choice.prior;
  Scores scores(std::size(kGrid));
  SLX_RETURN_IF_ERROR(Try(kWeak, scores.size(), left, trial, scores));
  if (CountOf(scores[kWeak]) < kLeastJudged) return choice;
  size_t first = kWeak;
  if (!IsWorse(scores[first], scores[BestOf(scores, first)], kSurely)) {
    SLX_RETURN_IF_ERROR(Try(0, kWeak, left, trial, scores));
    first = 0;
  }
  const size_t best = BestOf(scores, first);
  bool chosen = false;
  for (size_t t = first; t < scores.size(); ++t) {
    choice.trials.push_back({kGrid[t], DivergenceOf(scores[t]) / PhotonsOf(scores[t])});
    // The weakest that these profiles do not tell from the best.
    if (chosen || IsWorse(scores[t], scores[best], 1.0)) continue;
    choice.prior.photons = kGrid[t];
    chosen = true;
  }
  return choice;
}

Result<NeighboursChoice> ChooseNeighboursPrior(std::span<const SrdBatch* const> lights, const LeftOutLights& left,
                                               int width, int height, const EmOptions& options, double spacing_mm) {
  NeighboursChoice choice;
  if (left.turns.empty() || !(options.prior.photons > 0.0) || !(spacing_mm > 0.0)) return choice;
  std::vector<double> photons;
  for (const double times : kNeighboursGrid)
    photons.push_back(std::min(times * options.prior.photons, kMostPriorPhotons));
  const std::vector<Patch> patches = PatchesOf(lights, left, width, height, spacing_mm);
  const size_t turns = left.turns.size();
  std::vector<Scores> of_patches(patches.size() * turns);
  // A patch has too few profiles for all threads.
  SLX_RETURN_IF_ERROR(ParallelTry(of_patches.size(), [&](size_t i) -> Status {
    SLX_ASSIGN_OR_RETURN(of_patches[i], TryNeighbours(patches[i / turns], lights, left.turns[i % turns], left.channels,
                                                      options, spacing_mm, photons));
    return Status::Ok();
  }));
  Scores scores(1 + photons.size());
  for (const Scores& these : of_patches)
    for (size_t t = 0; t < scores.size(); ++t) scores[t].insert(scores[t].end(), these[t].begin(), these[t].end());
  if (CountOf(scores[0]) < kLeastJudged) return choice;
  double least = 0.0;
  for (size_t t = 1; t < scores.size(); ++t) {
    choice.trials.push_back({photons[t - 1], MoreThan(scores[0], scores[t])});
    if (choice.trials.back().more_nats >= least) continue;
    least = choice.trials.back().more_nats;
    choice.photons = choice.trials.back().photons;
  }
  return choice;
}

}  // namespace stratalux::fit
