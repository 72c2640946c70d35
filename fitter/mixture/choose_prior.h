// SPDX-License-Identifier: Apache-2.0
// The strength of the session's prior, chosen by the data: how well do the layers predict a light that they were not
// fitted to?
#pragma once

#include <span>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/left_out_lights.h"
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

// On the pixels of `left` each projector is left out in turn, columns and rows: mean layers and tied fits of the others
// predict its samples. From a logarithmic grid of 0, few to endlessly many photons the least N0 whose divergence is not
// a standard error above the best one's. 0 and 100 are left out where 300 is three above it. The same bits for any
// number of threads.
[[nodiscard]] Result<PriorChoice> ChoosePrior(const LeftOutLights& left, const EmOptions& options);

// Whether a pixel's neighbours know it better than the session's mean does, and how much.
struct NeighboursChoice {
  struct Trial {
    double photons = 0.0;
    double more_nats = 0.0;  // divergence of a profile of the light left out above that by the session's prior, mean
  };
  double photons = 0.0;       // of the prior centred on them (FitAmongNeighbours); 0: the session's is as good
  std::vector<Trial> trials;  // empty where none could be made
};

// Around twelve places of skin that two projectors show, each projector is left out in turn: fits of the others among
// neighbours, with options.prior.photons (the session's N0) times 1, 3, 10 and 30, and by the session's mean. The best
// of them, by the middle four fifths of the profiles: at an edge of the skin (a brow's hair, a nostril) a few would
// outvote all others. `left`: of these lights; `options`, `spacing_mm`: as of FitAmongNeighbours. The same bits for any
// number of threads.
[[nodiscard]] Result<NeighboursChoice> ChooseNeighboursPrior(std::span<const SrdBatch* const> lights,
                                                             const LeftOutLights& left, int width, int height,
                                                             const EmOptions& options, double spacing_mm);

}  // namespace stratalux::fit
