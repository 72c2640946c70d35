// SPDX-License-Identifier: Apache-2.0
// A fit as files: what `run` leaves in STORE/sessions/<id>/fits/<fit> and what relighting reads back.
#pragma once

#include <filesystem>

#include "fitter/mixture/mixture_map.h"
#include "fitter/pipeline/geometry_stage.h"
#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

// Maps as EXR, mesh as PLY.
Status WriteMaps(const std::filesystem::path& folder, const FaceGeometry& face, const SurfaceMap& surface);
// layers_*.exr, floor.exr (surface term and background of each training light), quality.exr (divergence, iterations,
// reason, `signal_to_noise`, W x H x C, and the prior's share), layers.json.
Status WriteLayers(const std::filesystem::path& folder, const MixtureMap& map, const Image<float>& signal_to_noise,
                   int pool);

struct SavedFit {
  SurfaceMap surface;
  MixtureMap map;
  int pool = 1;
};
// kNotFound: no such fit; kIntegrity: its files do not belong together; kNewerSchema.
[[nodiscard]] Result<SavedFit> LoadFit(const std::filesystem::path& folder);

}  // namespace stratalux::fit
