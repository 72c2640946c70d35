// SPDX-License-Identifier: Apache-2.0
// The fit of ONE profile in double precision, and what it says of the profile's lights.
#pragma once

#include <span>
#include <vector>

#include "fitter/mixture/fine_grid.h"
#include "fitter/mixture/layer_set.h"
#include "fitter/mixture/profile_light.h"

namespace stratalux::fit {

struct ProfileFit {
  LayerSet layers;                          // LayerSet::background is not used here
  std::vector<double> surface, background;  // by light
  double tau = 0.0;
  DirectionalWeights directional;
  double divergence = 0.0;  // Kullback-Leibler over the data's sum
  int iterations = 0;       // sweeps
};

// Light of a layer of weight 1: g_p w_lp / w_l.
[[nodiscard]] double LayerFactor(const ProfileLight& light, const ProfileFit& fit, double depth_mm, double sigma_mm);

// The fit's own samples of its light `p`, whose grid that is: B m + surface + background.
[[nodiscard]] std::vector<double> ModelOf(const ProfileFit& fit, const FineGrid& grid, size_t p);

// How far samples are from those of a model (shifted Poisson), in photons.
struct Misfit {
  double divergence = 0.0;  // Kullback-Leibler
  double photons = 0.0;     // of the data, pedestal included
};
[[nodiscard]] Misfit MisfitOf(const ProfileLight& light, const std::vector<double>& model);

// Layers that EM starts from when it is given none: widths spread over all scales.
[[nodiscard]] LayerSet SpreadLayers(std::span<const ProfileLight> lights, const EmOptions& options);

}  // namespace stratalux::fit
