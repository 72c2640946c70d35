// SPDX-License-Identifier: Apache-2.0
// Random layered skins and their profiles, for the tests of fitter/mixture.
#pragma once

#include <cstdint>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/layer_set.h"
#include "fitter/mixture/mixture_map.h"
#include "fitter/mixture/srd_samples.h"
#include "shared/base/random.h"

namespace stratalux::fit {

struct EmCases {
  std::vector<SrdBatch> batches;  // one a light
  std::vector<LayerSet> skins;    // [profile]
  [[nodiscard]] std::vector<const SrdBatch*> lights() const;
};

struct EmCaseOptions {
  int profiles = 16, samples = 64;
  double coarse = 1.0;  // times the usual steps, lines and blurs, as seen by a camera of few pixels
  bool wrapped = true;
  double peak_counts = 4000.0;
  // Variance of the read noise, photons^2. A camera's has some electrons; 0: hardly any (0.00002 in units of y), by
  // which half of the dark samples lie below what EM takes, as black.
  double read_photons = 0.0;
  // Profiles that share a skin, up to so much in every weight, depth and width, as neighbouring pixels do; 1: none.
  int alike = 1;
  double unlike = 0.2;
  std::vector<LayerSet> skins = {};                // that they share, one after another; empty: random ones
  int pool = 1;                                    // above: samples average pool x pool quads, two sites in each
  std::vector<double> slopes = {-1.0, 0.0, 0.58};  // tangents of incidence, one a light
};

// Three to seven layers a skin, widths 0.15 to 4 mm, depths 0.02 to 2 mm; steps, blurs and offsets of their own.
[[nodiscard]] EmCases MakeEmCases(const EmCaseOptions& cases, const EmOptions& options, uint64_t seed);

// What the fitted layers make of a light that nobody saw, against the true layers: rms over one profile in `every` of
// the NRMSE of shapes, each with its own sum, as the camera of `seen_by` sees them.
[[nodiscard]] double ShapeError(const EmCases& made, const MixtureMap& map, const EmOptions& options, int every = 1,
                                const EmCaseOptions& seen_by = {});

}  // namespace stratalux::fit
