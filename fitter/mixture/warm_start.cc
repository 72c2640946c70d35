// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/warm_start.h"

#include <algorithm>
#include <cmath>
#include <functional>

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

// The sampled profiles of each light.
class SampledBatches {
 public:
  SampledBatches(std::span<const SrdBatch* const> lights, std::span<const int64_t> which) {
    for (const SrdBatch* light : lights) parts_.push_back(ProfilesOf(*light, which));
    for (const SrdBatch& part : parts_) batches_.push_back(&part);
  }
  [[nodiscard]] std::span<const SrdBatch* const> batches() const { return batches_; }

 private:
  std::vector<SrdBatch> parts_;
  std::vector<const SrdBatch*> batches_;
};

// The sampled pixels as a row, fitted as in `fit`.
MixtureMap SampledRow(const MixtureMap& fit, std::span<const int64_t> which) {
  MixtureMap row;
  row.width = static_cast<int>(which.size()) / fit.channels;
  row.height = 1;
  row.channels = fit.channels;
  row.layers = fit.layers;
  row.scattering = fit.scattering;
  row.prior_photons = fit.prior_photons;
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

// Mean difference over the profiles that `wanted` says.
double MeanAbove(const std::vector<float>& cost, const std::vector<float>& referee, const std::vector<uint8_t>& wanted,
                 int64_t count) {
  double sum = 0.0;
  for (size_t i = 0; i < cost.size(); ++i)
    if (wanted[i] != 0) sum += double(cost[i]) - double(referee[i]);
  return sum / static_cast<double>(count);
}

int MedianOf(std::vector<uint16_t> sweeps, const std::vector<uint8_t>& wanted) {
  size_t kept = 0;
  for (size_t i = 0; i < sweeps.size(); ++i)
    if (wanted[i] != 0) sweeps[kept++] = sweeps[i];
  const auto middle = sweeps.begin() + static_cast<int64_t>(kept / 2);
  std::nth_element(sweeps.begin(), middle, sweeps.begin() + static_cast<int64_t>(kept));
  return *middle;
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
  const auto swept = [&](int sweeps) {
    EmOptions few = options;
    few.max_iterations = few.refinement_iterations = sweeps;
    return RefineMixture(sampled.batches(), projectors, none, 0, few, start);
  };
  SLX_ASSIGN_OR_RETURN(const auto referee, swept(kRefereeSweeps));
  std::vector<uint8_t> wanted;
  for (const float cost : referee.cost) wanted.push_back(std::isfinite(cost) ? 1 : 0);
  choice.profiles = referee.added;
  if (choice.profiles == 0) return choice;
  choice.referee_sweeps = MedianOf(referee.map.iterations, wanted);
  for (int sweeps = 1; sweeps <= std::max(options.refinement_iterations, 1) && !choice.Reached(); ++sweeps) {
    SLX_ASSIGN_OR_RETURN(const auto trial, swept(sweeps));
    choice.sweeps = sweeps;
    choice.trials.push_back({sweeps, MeanAbove(trial.cost, referee.cost, wanted, choice.profiles)});
  }
  return choice;
}

Result<WarmStartChoice> ChooseWarmSweeps(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                         const MixtureMap& fit, const EmOptions& options,
                                         std::span<const LayerSet> start) {
  WarmStartChoice choice;
  const std::vector<int64_t> which =
      SampleOf(fit.profiles(), fit.channels, [&](int64_t i) { return FurtherLit(lights, projectors, fit, i); });
  const SampledBatches sampled_batches(lights, which);
  const auto sampled = sampled_batches.batches();
  EmOptions of_fit = options;
  of_fit.scattering = fit.scattering;
  of_fit.prior.photons = fit.prior_photons;
  const MixtureMap row = SampledRow(fit, which), none = UnfittedMap(row.width, 1, fit.channels, of_fit);
  // Without a prior EM starts from widths spread over all scales, with its own number of sweeps.
  EmOptions endless = options;
  endless.max_iterations = endless.refinement_iterations = kRefereeSweeps;
  if (which.empty()) return choice;
  SLX_ASSIGN_OR_RETURN(const auto referee, RefineMixture(sampled, projectors, none, 0, endless, start));
  SLX_ASSIGN_OR_RETURN(const auto cold, RefineMixture(sampled, projectors, none, 0, options, start));

  std::vector<uint8_t> wanted;
  for (int sweeps = 1; sweeps <= std::max(options.refinement_iterations, 1); ++sweeps) {
    SLX_ASSIGN_OR_RETURN(const auto warm, RefineMixture(sampled, projectors, row, sweeps, options, start));
    if (wanted.empty()) {  // of the sampled, those that the further lights' samples reach
      for (size_t i = 0; i < warm.cost.size(); ++i)
        wanted.push_back(row.Fitted(static_cast<int64_t>(i)) && std::isfinite(warm.cost[i]) ? 1 : 0);
      choice.profiles = warm.refined;
      if (choice.profiles == 0) return choice;
      choice.cold_sweeps = MedianOf(cold.map.iterations, wanted);
      choice.cold_nats = MeanAbove(cold.cost, referee.cost, wanted, choice.profiles);
      choice.referee_sweeps = MedianOf(referee.map.iterations, wanted);
    }
    choice.sweeps = sweeps;
    EmOptions few = options;
    few.max_iterations = few.refinement_iterations = sweeps;
    SLX_ASSIGN_OR_RETURN(const auto as_cold, RefineMixture(sampled, projectors, none, 0, few, start));
    choice.trials.push_back({sweeps, MeanAbove(warm.cost, referee.cost, wanted, choice.profiles),
                             MeanAbove(as_cold.cost, referee.cost, wanted, choice.profiles)});
    if (choice.Reached()) break;
  }
  return choice;
}

}  // namespace stratalux::fit
