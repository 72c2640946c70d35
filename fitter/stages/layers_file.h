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

struct SavedFit {
  FaceShape shape;
  MixtureMap map;
  int pool = 1;
};
// Of a fit's folder: the files of its shape and of its layers.
[[nodiscard]] Result<SavedFit> LoadFit(const std::filesystem::path& folder);

}  // namespace stratalux::fit
