// SPDX-License-Identifier: Apache-2.0
// The strength of the session's prior, chosen by the data: how well do the layers predict a light that they were not
// fitted to?
#pragma once

#include <span>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/srd_samples.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// N0 where there is no light to leave out, or too little data: about what sessions of simulated skin choose.
inline constexpr double kUsualPriorPhotons = 1000.0;

struct PriorChoice {
  struct Trial {
    double photons = 0.0;     // N0
    double divergence = 0.0;  // Kullback-Leibler of the lights left out, over their photons; noise included
  };
  LayerPrior prior;
  std::vector<Trial> trials;  // empty where none could be made
};

// On some 500 pixels each projector of `projectors` (the batches' own) is left out in turn, columns and rows: mean
// layers and tied fits of the others predict its samples. From a logarithmic grid of 0, few to endlessly many photons
// the least N0 whose divergence is not a standard error above the best one's; 0 and 100 are left out where 300 is three
// above it. The same bits for any number of threads.
[[nodiscard]] Result<PriorChoice> ChoosePrior(std::span<const SrdBatch* const> lights,
                                              const std::vector<int>& projectors, int channels,
                                              const EmOptions& options);

}  // namespace stratalux::fit
