// SPDX-License-Identifier: Apache-2.0
// How many sweeps EM needs until data could not tell it from one that has settled.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "fitter/mixture/fit_mixture.h"

namespace stratalux::fit {

// Of EM from the mean layers. Costs are negative log posteriors (TracedFit::cost), means over the sampled profiles, in
// nats above those of EM that has settled, the referee.
struct SweepChoice {
  struct Trial {
    int sweeps = 0;
    double excess_nats = 0.0;
  };
  int sweeps = 0;             // of the last trial
  std::vector<Trial> trials;  // in rising order; the last is the first one within kSweepToleranceNats, or of the most
  int referee_sweeps = 0;     // median: it ends when it settles
  int64_t profiles = 0;       // sampled; 0: none can be fitted, nothing was tried
  [[nodiscard]] bool Reached() const;
};

// A profile's noise alone costs half a nat for each of the some ten numbers that its samples tell: a twentieth of what
// one of them costs is nothing that data could show.
inline constexpr double kSweepToleranceNats = 0.025;
// Enough to tell; more cost time.
inline constexpr int64_t kSweepPixels = 512;
inline constexpr uint64_t kSweepSeed = 19;

// The fewest sweeps of FitMixture (same arguments, of `channels` profiles a pixel) after which the mean cost of some
// 512 pixels that a light reaches, drawn by a seed, is within kSweepToleranceNats of the referee's. At most
// options.refinement_iterations. The same for any number of threads.
[[nodiscard]] Result<SweepChoice> ChooseSweeps(std::span<const SrdBatch* const> lights,
                                               const std::vector<int>& projectors, int channels,
                                               const EmOptions& options, std::span<const LayerSet> start);

}  // namespace stratalux::fit
