// SPDX-License-Identifier: Apache-2.0
// The predict stage: what a fit says of the held-out projector's lights.
#pragma once

#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "fitter/evaluation/heldout_view.h"
#include "fitter/mixture/mixture_map.h"
#include "shared/capture/plan.h"

namespace stratalux::fit {

inline constexpr int kPredictVersion = 9;

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

// Sum of the layers' weights of each profile.
[[nodiscard]] std::vector<double> TotalWeights(const MixtureMap& map);

// The predictions of layers that are those of `map` but for each profile's total weight, in which subsurface light is
// linear: from the predictions of layers of total weights `of` to those of total weights `to`. (Layers themselves would
// be most of the memory of a run.)
[[nodiscard]] Predictions ScaledPredictions(Predictions predictions, const MixtureMap& map, std::span<const double> of,
                                            std::span<const double> to, int pool);

// <light>_subsurface.exr, <light>_surface.exr, <light>_direct_part.exr, predict.json.
Status SavePredictions(const std::filesystem::path& folder, const Predictions& predictions);
[[nodiscard]] Result<Predictions> LoadPredictions(const std::filesystem::path& folder);

}  // namespace stratalux::fit
