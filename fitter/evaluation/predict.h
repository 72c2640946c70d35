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

inline constexpr int kPredictVersion = 17;

// Quads x colours.
struct Prediction {
  // By light: digital numbers above black, 0 outside the surface, NaN where that colour was not fitted.
  std::map<std::string, Image<float>> subsurface;
  // Of any light's irradiance on the surface that it was predicted on; NaN where nothing was fitted.
  Image<float> reflectance;   // by the fit's own reflection of the surface itself
  Image<float> direct_share;  // of `subsurface`, what separation would call direct (direct_light.h)
  // By light (HeldOutView), where that is another surface than the one that is judged; empty: it is that one.
  std::map<std::string, Image<float>> own_irradiance;

  // Under `light`, whose irradiance on the judged surface that is, as `subsurface` under it.
  [[nodiscard]] Image<float> SurfaceLight(const std::string& light, const Image<float>& irradiance) const;
  [[nodiscard]] Image<float> DirectLight(const std::string& light, const Image<float>& irradiance) const;
  // All of it: `subsurface` and SurfaceLight.
  [[nodiscard]] Image<float> AllLight(const std::string& light, const Image<float>& irradiance) const;
};

// Lights that sessions of the plan hold: stripe, white and, where it has them, spot.
[[nodiscard]] std::vector<std::string> HeldOutLights(const PlanOptions& plan);

// `map`: on the quads of the shape that the view was made of.
[[nodiscard]] Prediction Predict(const MixtureMap& map, int pool, const HeldOutView& view);

// Sum of the layers' weights of each profile.
[[nodiscard]] std::vector<double> TotalWeights(const MixtureMap& map);

// The prediction of layers that are those of `map` but for each profile's total weight, in which subsurface light is
// linear: from the prediction of layers of total weights `of` to that of total weights `to`. (Layers themselves would
// be most of the memory of a run.) `on_view`: ProfilesOnView of the view that was predicted on.
[[nodiscard]] Prediction ScaledPrediction(Prediction prediction, const MixtureMap& map, std::span<const double> of,
                                          std::span<const double> to, int pool, std::span<const int64_t> on_view = {});

// <light>_subsurface.exr, reflectance.exr, direct_share.exr, of one with an irradiance of its own
// <light>_irradiance.exr; predict.json.
Status SavePrediction(const std::filesystem::path& folder, const Prediction& prediction);
[[nodiscard]] Result<Prediction> LoadPrediction(const std::filesystem::path& folder);

}  // namespace stratalux::fit
