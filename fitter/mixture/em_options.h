// SPDX-License-Identifier: Apache-2.0
// What EM is told of the fit of one profile; every profile of a map has the same.
#pragma once

#include "fitter/mixture/scattering_model.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// Where profiles start from given layers (FitMixture's `start`), EM finds the maximum a posteriori: as if `photons` of
// a pixel with those layers had been seen beside the profile's own, under lights of mean s^2 `square_shift`
// (docs/math/em.md, "The prior").
struct LayerPrior {
  double photons = 0.0;  // N0; 0: no prior
  // 1: depths are held as closely as widths. The lights' own, about 0.1, left them too free: the stripe light of a
  // held-out projector was predicted to 3.82 % instead of 3.64 %.
  double square_shift = 1.0;
};

// The surface's share of the light that returns, where its reflection is unknown (skin's is 3 to 7 %; EM does not
// identify it and leaves it near there).
inline constexpr double kUnknownSurface = 0.05;

// More overflow single precision.
inline constexpr double kMostPriorPhotons = 1e7;

struct EmOptions {
  int layers = 20;  // [M]'s choice
  ScatteringModel scattering;
  bool direction_blind = false;  // every depth stays 0: the baseline
  // Light reflected at the surface itself. Where scattering.reflection is known its term is held; where not, it starts
  // at 5 % of the light, near which EM leaves it.
  bool surface_term = true;
  // A uniform floor beside the layers. A comb's cycle does not tell it from the widest layers: where there is none (the
  // black frame takes the ambient light) EM gives it 1 to 2 % of the light, which no renderer puts back.
  bool background_term = false;
  bool shared_background = false;  // one floor for all lights
  LayerPrior prior;
  // Of a pixel by itself. Accelerated ones, worth 50 plain ones (docs/math/em-kernel.md): held-out light is predicted
  // best at 50-100 plain sweeps (model section 7).
  int max_iterations = 20;
  // Of a pixel that starts from given layers (FitMixture's `start`), which are not far; 16 are worth 50 plain ones. The
  // fit stage takes as many of them as data can tell (ChooseSweeps).
  int refinement_iterations = 12;
  double tolerance = 1e-5;  // relative change of the divergence
  // Nesterov's momentum with restart: never loses likelihood (with a prior: posterior), and reaches that of plain EM in
  // a third of its sweeps.
  bool accelerated = true;
  int cells_per_sample = 4;
  double max_cell_mm = 0.15;   // coarser grids cost accuracy (model section 7)
  double min_sigma_mm = 0.12;  // and never below nine tenths of a cell
  double max_sigma_mm = 11.0;
  double min_depth_mm = -0.5;  // slightly negative: a common depth bias of the geometry is absorbed here
  double max_depth_mm = 8.0;
  [[nodiscard]] Status Validate() const;
};

}  // namespace stratalux::fit
