// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/choose_sweeps.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "fitter/mixture/sampled_lights.h"
#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

// Of the referee, at most: it settles long before.
constexpr int kRefereeSweeps = 300;

// The profiles of kSweepPixels pixels, drawn by a seed, of those with a candidate among their profiles.
std::vector<int64_t> SampleOf(int64_t profiles, int channels, const std::function<bool(int64_t)>& candidate) {
  std::vector<int64_t> pixels;
  for (int64_t i = 0; i < profiles; i += channels) {
    bool any = false;
    for (int c = 0; c < channels; ++c) any = any || candidate(i + c);
    if (any) pixels.push_back(i / channels);
  }
  const auto wanted = std::min<size_t>(pixels.size(), kSweepPixels);
  Random random(kSweepSeed);
  for (size_t k = 0; k < wanted; ++k) std::swap(pixels[k], pixels[k + random.Bits() % (pixels.size() - k)]);
  pixels.resize(wanted);
  std::sort(pixels.begin(), pixels.end());
  std::vector<int64_t> sample;
  for (const int64_t pixel : pixels)
    for (int c = 0; c < channels; ++c) sample.push_back(pixel * channels + c);
  return sample;
}

// By how much all that was fitted would have cost more after so many sweeps.
double SumAbove(const TracedFit& referee, int sweeps) {
  const size_t all = referee.cost_after.size() / referee.cost.size();
  double sum = 0.0;
  for (size_t i = 0; i < referee.cost.size(); ++i)
    if (std::isfinite(referee.cost[i]))
      sum += double(referee.cost_after[i * all + static_cast<size_t>(sweeps) - 1]) - double(referee.cost[i]);
  return sum;
}

int MedianSweeps(const TracedFit& referee) {
  std::vector<uint16_t> sweeps;
  for (size_t i = 0; i < referee.cost.size(); ++i)
    if (std::isfinite(referee.cost[i])) sweeps.push_back(referee.map.iterations[i]);
  const auto middle = sweeps.begin() + static_cast<int64_t>(sweeps.size() / 2);
  std::nth_element(sweeps.begin(), middle, sweeps.end());
  return *middle;
}

EmOptions UntilTheySettle(EmOptions options) {
  options.max_iterations = options.refinement_iterations = kRefereeSweeps;
  return options;
}

}  // namespace

bool SweepChoice::Reached() const { return !trials.empty() && trials.back().excess_nats <= kSweepToleranceNats; }

Result<SweepChoice> ChooseSweeps(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                 int channels, const EmOptions& options, std::span<const LayerSet> start) {
  SweepChoice choice;
  const std::vector<int64_t> which = SampleOf(lights[0]->profiles(), channels, [&](int64_t i) {
    return std::ranges::any_of(lights, [i](const SrdBatch* light) { return light->Shares(i); });
  });
  if (which.empty()) return choice;
  const SampledBatches sampled(lights, which);
  const int most = std::max(options.refinement_iterations, 1);
  const int pixels = static_cast<int>(std::ssize(which)) / channels;
  SLX_ASSIGN_OR_RETURN(const TracedFit referee, FitTraced(sampled.batches(), projectors, pixels, 1, channels,
                                                          UntilTheySettle(options), start, most));
  choice.profiles = std::ranges::count_if(referee.cost, [](float cost) { return std::isfinite(cost); });
  if (choice.profiles == 0) return choice;
  choice.referee_sweeps = MedianSweeps(referee);
  for (int sweeps = 1; sweeps <= most && !choice.Reached(); ++sweeps) {
    choice.sweeps = sweeps;
    choice.trials.push_back({sweeps, SumAbove(referee, sweeps) / static_cast<double>(choice.profiles)});
  }
  return choice;
}

}  // namespace stratalux::fit
