// SPDX-License-Identifier: Apache-2.0
// The predict stage: what a fit says of the held-out projector's lights.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "fitter/evaluation/heldout_view.h"
#include "fitter/mixture/mixture_map.h"
#include "shared/capture/plan.h"

namespace stratalux::fit {

inline constexpr int kPredictVersion = 4;

// Under one light; quads x colours, digital numbers above black; 0 outside the surface, NaN where that colour was not
// fitted.
struct Prediction {
  Image<float> subsurface;
  Image<float> surface;      // by the fit's own reflection of the very surface
  Image<float> direct_part;  // of `subsurface`, what separation would call direct (direct_light.h)
};
using Predictions = std::map<std::string, Prediction>;  // by light

// Lights that sessions of the plan hold: stripe, white and, where it has them, spot.
[[nodiscard]] std::vector<std::string> HeldOutLights(const PlanOptions& plan);

[[nodiscard]] Predictions Predict(const MixtureMap& map, int pool, const HeldOutView& view);

// The predictions of `scaled` from those of `map`: of the same fit, with the same layers but for the total weight of
// each profile, in which subsurface light is linear.
[[nodiscard]] Predictions ScaledPredictions(Predictions predictions, const MixtureMap& map, const MixtureMap& scaled,
                                            int pool);

// <light>_subsurface.exr, <light>_surface.exr, <light>_direct_part.exr, predict.json.
Status SavePredictions(const std::filesystem::path& folder, const Predictions& predictions);
[[nodiscard]] Result<Predictions> LoadPredictions(const std::filesystem::path& folder);

}  // namespace stratalux::fit
