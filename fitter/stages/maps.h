// SPDX-License-Identifier: Apache-2.0
// The maps stage: the layers that are shown and exported, from all projectors. The fit leaves one out, by which it is
// judged; these are a fit of their own (docs/math/em.md, "Maps from all projectors"), and nothing that judges a fit
// reads them.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "fitter/stages/layers.h"
#include "fitter/stages/layers_file.h"

namespace stratalux::fit {

inline constexpr int kMapsVersion = 15;

struct MapsFigures {
  std::string provenance;       // ProvenanceOf
  std::vector<int> projectors;  // whose sweeps the layers are fitted to, each once
  int heldout = 0;              // of them, the one that the fit left out
  int64_t fitted = 0;           // profiles
  std::map<std::string, int64_t> masked_by_reason;
  double divergence = 0.0;  // median of what is fitted
};

struct AllLayers {
  FittedLayers layers;
  MapsFigures figures;
};

// `heldout`: of the fit that these stand beside; `shared`: found by all lights.
[[nodiscard]] Result<AllLayers> FitMaps(const SrdSet& srds, int heldout, const FitOptions& options,
                                        const SharedLight& shared, Logger& logger, const std::string& label);

// maps/: the files of SaveLayers and WriteLayerMaps, and maps.json.
Status SaveMaps(const std::filesystem::path& folder, const AllLayers& made);
[[nodiscard]] Result<FittedLayers> LoadMaps(const std::filesystem::path& folder);
[[nodiscard]] Result<MapsFigures> LoadMapsFigures(const std::filesystem::path& folder);

}  // namespace stratalux::fit
