// SPDX-License-Identifier: Apache-2.0
// The session's directional weights and angular gain, chosen on the training lights alone.
#pragma once

#include <span>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/srd_samples.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct DirectionEstimate {
  double tau = 0.0;
  DirectionalWeights weights;
  // Kullback-Leibler divergence over the data's sum, mean of the sampled profiles weighted by their photons: with the
  // weights, and without.
  double divergence = 0.0, divergence_without = 0.0;
};

// tau from the light that spread beyond the reach of the surface's own reflection (options.tau where that reflection
// is known: it has no part in it already); then coordinate descent of the training divergence over kappa, phase slope
// and sigma_0 (directional_weights.h), each tried a step up and a step down from where it stands, steps halved as they
// cease to help. Every trial fits one pixel in `every` anew. `options.tau` is kept where no pixel is seen by all
// lights. The same bits for any number of threads.
[[nodiscard]] Result<DirectionEstimate> EstimateDirections(std::span<const SrdBatch* const> lights, int channels,
                                                           EmOptions options, int every = 64);

}  // namespace stratalux::fit
