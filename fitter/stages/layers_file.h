// SPDX-License-Identifier: Apache-2.0
// Fitted layers as files: of the fit stage's artifact, and of a whole fit, which relighting reads back.
#pragma once

#include <filesystem>
#include <string>

#include "fitter/mixture/mixture_map.h"
#include "fitter/reconstruction/surface_map.h"
#include "fitter/stages/shape.h"

namespace stratalux::fit {

struct FittedLayers {
  MixtureMap map;
  int pool = 1;
  Image<float> signal_to_noise;  // W x H x C, of SignalToNoise()
};

// layers_*.exr, floor.exr (surface term and background of each training light), quality.exr (divergence, iterations,
// reason, signal-to-noise ratio and the prior's share), layers.json.
Status SaveLayers(const std::filesystem::path& folder, const FittedLayers& layers);
// kNotFound: none there; kIntegrity: its files do not belong together; kNewerSchema.
[[nodiscard]] Result<FittedLayers> LoadLayers(const std::filesystem::path& folder);

// Whose light a map is fitted to, each projector once.
[[nodiscard]] std::vector<int> DistinctProjectors(const MixtureMap& map);
// The same as exports and reports say it, of a rig with so many: "from four projectors", "from three projectors,
// projector 3 held out".
[[nodiscard]] std::string ProvenanceOf(const MixtureMap& map, int projectors);

// Below an artifact or a fit: the layers of all projectors (fitter/stages/maps.h), in files of the names above.
inline constexpr const char* kMapsFolder = "maps";
// Of a fit: those of all projectors where it has them, else its own; those alone; its own alone, which leave a
// projector out.
enum class LayerChoice { kBest, kMaps, kFit };

struct SavedFit {
  FaceShape shape;
  MixtureMap map;
  int pool = 1;
  std::string provenance = {};  // ProvenanceOf
};
// Of a fit's folder: the files of its shape and of its layers. kNotFound: it has none such.
[[nodiscard]] Result<SavedFit> LoadFit(const std::filesystem::path& folder, LayerChoice choice = LayerChoice::kBest);

}  // namespace stratalux::fit
