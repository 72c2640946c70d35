// SPDX-License-Identifier: Apache-2.0
// What a fit amounts to in a few figures: of the fit stage's artifact.
#pragma once

#include <filesystem>
#include <map>
#include <string>

#include "fitter/mixture/srd_centroid.h"
#include "fitter/mixture/surface_reflection.h"
#include "fitter/stages/srd.h"

namespace stratalux::fit {

struct FitSummary {
  double divergence = 0.0;  // median
  int iterations_median = 0;
  double tau = 0.0;
  SurfaceReflection reflection;
  double wide_weight_fraction = 0.0;  // weight in layers wider than one line, of the total of layers and surface
  int64_t pixels = 0;
  double prior_photons = 0.0;  // N0 of the prior (docs/math/em.md); 0: none
  int64_t weak_pixels = 0;  // fitted, of fewer photons than that: their layers lean on its centre (neighbours, session)
  std::map<std::string, int64_t> masked_by_reason;
  CentroidError centroid;  // of the held-out projector's SRDs
};

// Of what is fitted; 0: nothing.
[[nodiscard]] double MedianDivergence(const MixtureMap& map);
// Profiles that have any other reason than that they are fitted.
[[nodiscard]] std::map<std::string, int64_t> MaskedByReason(const MixtureMap& map);

[[nodiscard]] FitSummary Summarise(const MixtureMap& map, const SrdSet& srds, int heldout);

Status SaveSummary(const std::filesystem::path& folder, const FitSummary& summary);  // summary.json
[[nodiscard]] Result<FitSummary> LoadSummary(const std::filesystem::path& folder);

}  // namespace stratalux::fit
