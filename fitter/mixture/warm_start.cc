// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/warm_start.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "fitter/mixture/sampled_lights.h"
#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

// Of the referee, at most: it settles long before.
constexpr int kRefereeSweeps = 300;

// The profiles of kWarmPixels pixels, drawn by a seed, of those with a candidate among their profiles.
std::vector<int64_t> SampleOf(int64_t profiles, int channels, const std::function<bool(int64_t)>& candidate) {
  std::vector<int64_t> pixels;
  for (int64_t i = 0; i < profiles; i += channels) {
    bool any = false;
    for (int c = 0; c < channels; ++c) any = any || candidate(i + c);
    if (any) pixels.push_back(i / channels);
  }
  const auto wanted = std::min<size_t>(pixels.size(), kWarmPixels);
  Random random(kWarmSeed);
  for (size_t k = 0; k < wanted; ++k) std::swap(pixels[k], pixels[k + random.Bits() % (pixels.size() - k)]);
  pixels.resize(wanted);
  std::sort(pixels.begin(), pixels.end());
  std::vector<int64_t> sample;
  for (const int64_t pixel : pixels)
    for (int c = 0; c < channels; ++c) sample.push_back(pixel * channels + c);
  return sample;
}

// Whether `fit` has the profile and a further light is said to reach it.
bool FurtherLit(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, const MixtureMap& fit,
                int64_t profile) {
  if (!fit.Fitted(profile)) return false;
  for (size_t p = 0; p < lights.size(); ++p)
    if (std::ranges::find(fit.training_projectors, projectors[p]) == fit.training_projectors.end() &&
        lights[p]->Shares(profile))
      return true;
  return false;
}

// The sampled pixels as a row, fitted as in `fit`.
MixtureMap SampledRow(const MixtureMap& fit, std::span<const int64_t> which) {
  MixtureMap row;
  row.width = static_cast<int>(which.size()) / fit.channels;
  row.height = 1;
  row.channels = fit.channels;
  row.layers = fit.layers;
  row.scattering = fit.scattering;
  row.prior_photons = fit.prior_photons;
  row.session_photons = fit.session_photons;
  row.training_projectors = fit.training_projectors;
  const auto pick = [&](auto field, size_t each) {
    if ((fit.*field).empty()) return;
    for (const int64_t i : which) {
      const auto from = (fit.*field).begin() + i * static_cast<int64_t>(each);
      (row.*field).insert((row.*field).end(), from, from + static_cast<int64_t>(each));
    }
  };
  const auto layers = static_cast<size_t>(fit.layers), lights = fit.training_projectors.size();
  for (const auto field : {&MixtureMap::weight, &MixtureMap::depth_mm, &MixtureMap::sigma_mm}) pick(field, layers);
  for (const auto field : {&MixtureMap::surface, &MixtureMap::background}) pick(field, lights);
  for (const auto field : {&MixtureMap::divergence, &MixtureMap::prior_share}) pick(field, 1);
  pick(&MixtureMap::iterations, 1);
  pick(&MixtureMap::reason, 1);
  return row;
}

// Mean of cost less the referee's over the profiles that `wanted` says: `sweeps` after the start of `traced`.
double MeanAbove(const RefinedMap& traced, int sweeps, const RefinedMap& referee, const std::vector<uint8_t>& wanted,
                 int64_t count) {
  const size_t all = traced.cost_after.size() / traced.cost.size();
  double sum = 0.0;
  for (size_t i = 0; i < wanted.size(); ++i)
    if (wanted[i] != 0)
      sum += double(traced.cost_after[i * all + static_cast<size_t>(sweeps) - 1]) - double(referee.cost[i]);
  return sum / static_cast<double>(count);
}

// Of the sweeps of those that are wanted, none of which makes more than `most`.
int MedianSweeps(std::vector<uint16_t> sweeps, const std::vector<uint8_t>& wanted, int most = kRefereeSweeps) {
  size_t kept = 0;
  for (size_t i = 0; i < sweeps.size(); ++i)
    if (wanted[i] != 0) sweeps[kept++] = sweeps[i];
  const auto middle = sweeps.begin() + static_cast<int64_t>(kept / 2);
  std::nth_element(sweeps.begin(), middle, sweeps.begin() + static_cast<int64_t>(kept));
  return std::min<int>(*middle, most);
}

EmOptions UntilTheySettle(EmOptions options) {
  options.max_iterations = options.refinement_iterations = kRefereeSweeps;
  return options;
}

}  // namespace

bool WarmStartChoice::Reached() const { return !trials.empty() && trials.back().excess_nats <= kWarmToleranceNats; }

bool SweepChoice::Reached() const { return !trials.empty() && trials.back().excess_nats <= kWarmToleranceNats; }

Result<SweepChoice> ChooseSweeps(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                 int channels, const EmOptions& options, std::span<const LayerSet> start) {
  SweepChoice choice;
  const std::vector<int64_t> which = SampleOf(lights[0]->profiles(), channels, [&](int64_t i) {
    return std::ranges::any_of(lights, [i](const SrdBatch* light) { return light->Shares(i); });
  });
  if (which.empty()) return choice;
  const SampledBatches sampled(lights, which);
  const MixtureMap none = UnfittedMap(static_cast<int>(std::ssize(which)) / channels, 1, channels, options);
  const int most = std::max(options.refinement_iterations, 1);
  SLX_ASSIGN_OR_RETURN(const auto referee, RefineMixture(sampled.batches(), projectors, none, 0,
                                                         UntilTheySettle(options), start, {}, most));
  std::vector<uint8_t> wanted;
  for (const float cost : referee.cost) wanted.push_back(std::isfinite(cost) ? 1 : 0);
  choice.profiles = referee.added;
  if (choice.profiles == 0) return choice;
  choice.referee_sweeps = MedianSweeps(referee.map.iterations, wanted);
  for (int sweeps = 1; sweeps <= most && !choice.Reached(); ++sweeps) {
    choice.sweeps = sweeps;
    choice.trials.push_back({sweeps, MeanAbove(referee, sweeps, referee, wanted, choice.profiles)});
  }
  return choice;
}

Result<WarmStartChoice> ChooseWarmSweeps(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                         const MixtureMap& fit, const EmOptions& options, const StartLayers& given) {
  WarmStartChoice choice;
  const std::vector<int64_t> which =
      SampleOf(fit.profiles(), fit.channels, [&](int64_t i) { return FurtherLit(lights, projectors, fit, i); });
  const SampledBatches sampled_batches(lights, which);
  const auto sampled = sampled_batches.batches();
  EmOptions of_fit = options;
  of_fit.scattering = fit.scattering;
  of_fit.prior.photons = fit.prior_photons;
  const MixtureMap row = SampledRow(fit, which), none = UnfittedMap(row.width, 1, fit.channels, of_fit);
  if (which.empty()) return choice;
  const ProfileLayers near = given.near == nullptr ? ProfileLayers{} : ProfilesOf(*given.near, which);
  StartLayers start = given;
  if (given.near != nullptr) start.near = &near;
  const int most = std::max(options.refinement_iterations, 1);
  // Without a prior EM starts from widths spread over all scales, with its own number of sweeps.
  const int most_cold = start.empty() ? options.max_iterations : most;
  SLX_ASSIGN_OR_RETURN(const auto referee, RefineMixture(sampled, projectors, none, 0, UntilTheySettle(options), start,
                                                         {}, std::max(most, most_cold)));
  SLX_ASSIGN_OR_RETURN(const auto warm, RefineMixture(sampled, projectors, row, most, options, start, {}, most));
  std::vector<uint8_t> wanted;  // of the sampled, those that the further lights' samples reach
  for (size_t i = 0; i < warm.cost.size(); ++i)
    wanted.push_back(row.Fitted(static_cast<int64_t>(i)) && std::isfinite(warm.cost[i]) ? 1 : 0);
  choice.profiles = warm.refined;
  if (choice.profiles == 0) return choice;
  choice.cold_sweeps = MedianSweeps(referee.map.iterations, wanted, most_cold);
  choice.cold_nats = MeanAbove(referee, most_cold, referee, wanted, choice.profiles);
  choice.referee_sweeps = MedianSweeps(referee.map.iterations, wanted);
  for (int sweeps = 1; sweeps <= most && !choice.Reached(); ++sweeps) {
    choice.sweeps = sweeps;
    choice.trials.push_back({sweeps, MeanAbove(warm, sweeps, referee, wanted, choice.profiles),
                             MeanAbove(referee, sweeps, referee, wanted, choice.profiles)});
  }
  return choice;
}

}  // namespace stratalux::fit
