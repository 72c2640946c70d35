// SPDX-License-Identifier: Apache-2.0
// The maps stage: the layers that are shown and exported, from all projectors. The fit leaves one out, by which it is
// judged; here its layers are refined by that one's sweep, too (docs/math/em.md, "Maps from all projectors"). Nothing
// that judges a fit reads them.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "fitter/mixture/warm_start.h"
#include "fitter/stages/layers.h"
#include "fitter/stages/layers_file.h"

namespace stratalux::fit {

inline constexpr int kMapsVersion = 7;

struct MapsFigures {
  std::string provenance;       // ProvenanceOf
  std::vector<int> projectors;  // whose sweeps the layers are fitted to, each once
  int heldout = 0;              // of them, the one that the fit left out
  WarmStartChoice warm;
  // Profiles, as of RefinedMap.
  int64_t refined = 0, kept = 0, added = 0, unusable = 0;
  double divergence = 0.0;  // median of what is fitted
};

struct RefinedLayers {
  FittedLayers layers;
  MapsFigures figures;
};

// `fit`: made of the same SRDs without `heldout`, and with `options`, tied.
[[nodiscard]] Result<RefinedLayers> RefineLayers(const SrdSet& srds, int heldout, FittedLayers fit,
                                                 const FitOptions& options, Logger& logger, const std::string& label);

// maps/: the files of SaveLayers and WriteLayerMaps, and maps.json.
Status SaveMaps(const std::filesystem::path& folder, const RefinedLayers& refined);
[[nodiscard]] Result<FittedLayers> LoadMaps(const std::filesystem::path& folder);
[[nodiscard]] Result<MapsFigures> LoadMapsFigures(const std::filesystem::path& folder);

}  // namespace stratalux::fit
