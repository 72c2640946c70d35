// SPDX-License-Identifier: Apache-2.0
// [M] as printed: each SRD is fitted on its own, its layers' means free. To predict another light, the layers of the
// training lights are averaged.
#pragma once

#include <functional>
#include <span>

#include "fitter/mixture/fit_mixture.h"

namespace stratalux::fit {

// Fits every light by itself (in free mode, whatever options.scattering.mode) and averages layer by layer. All lights
// start from the same layers (`start`, by channel; empty: widths spread over all scales), their means at u = 0, and EM
// keeps their order, so that layer l of one light answers layer l of another. With w, mu, sigma of the lights p that a
// profile has:
//   w_l = mean_p w_lp,   d_l = sum_p w_lp s_p mu_lp / sum_p w_lp s_p^2   (the depth whose shifts d_l s_p come nearest),
//   sigma_l^2 = sum_p w_lp sigma_lp^2 / sum_p w_lp.
// Divergence and iterations are means over those lights. `progress` as of FitMixture, once a profile and light.
Result<MixtureMap> FitFree(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, int width,
                           int height, int channels, EmOptions options, std::span<const LayerSet> start = {},
                           const std::function<void(int64_t)>& progress = {});

}  // namespace stratalux::fit
