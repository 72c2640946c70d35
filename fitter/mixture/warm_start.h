// SPDX-License-Identifier: Apache-2.0
// How many sweeps EM needs until data could not tell it from one that has settled: from the mean layers, and from a map
// of some of the lights.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "fitter/mixture/fit_mixture.h"

namespace stratalux::fit {

// Costs are negative log posteriors (RefinedMap::cost), means over the sampled profiles, in nats above the referee's.
struct WarmStartChoice {
  struct Trial {
    int sweeps = 0;
    double excess_nats = 0.0, cold_excess_nats = 0.0;  // from the map's layers; from the prior's centre
  };
  int sweeps = 0;             // of the last trial
  std::vector<Trial> trials;  // in rising order; the last is the first one within kWarmToleranceNats, or of the most
  int cold_sweeps = 0;        // of a fit, from the prior's centre, ...
  double cold_nats = 0.0;     // ... and where they end
  int referee_sweeps = 0;     // median: it ends when it settles
  int64_t profiles = 0;       // sampled, which the map has and a further light reaches; 0: none, nothing was tried
  [[nodiscard]] bool Reached() const;
};

// Of EM from the mean layers. Costs as above.
struct SweepChoice {
  struct Trial {
    int sweeps = 0;
    double excess_nats = 0.0;
  };
  int sweeps = 0;             // of the last trial
  std::vector<Trial> trials;  // as WarmStartChoice::trials
  int referee_sweeps = 0;     // median: it ends when it settles
  int64_t profiles = 0;       // sampled; 0: none can be fitted, nothing was tried
  [[nodiscard]] bool Reached() const;
};

// A profile's noise alone costs half a nat for each of the some ten numbers that its samples tell: a twentieth of what
// one of them costs is nothing that data could show.
inline constexpr double kWarmToleranceNats = 0.025;
// Enough to tell; more cost time.
inline constexpr int64_t kWarmPixels = 512;
inline constexpr uint64_t kWarmSeed = 19;

// The fewest sweeps of RefineMixture (same arguments) after which the mean cost of some 512 pixels, drawn by a seed, is
// within kWarmToleranceNats of the referee's: EM from the prior's centre until it settles. At most
// options.refinement_iterations. The same for any number of threads.
[[nodiscard]] Result<WarmStartChoice> ChooseWarmSweeps(std::span<const SrdBatch* const> lights,
                                                       const std::vector<int>& projectors, const MixtureMap& fit,
                                                       const EmOptions& options, const StartLayers& start);

// The fewest sweeps of FitMixture (same arguments, of `channels` profiles a pixel) after which that holds of some 512
// pixels that a light reaches.
[[nodiscard]] Result<SweepChoice> ChooseSweeps(std::span<const SrdBatch* const> lights,
                                               const std::vector<int>& projectors, int channels,
                                               const EmOptions& options, std::span<const LayerSet> start);

}  // namespace stratalux::fit
