// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/predict.h"

#include <array>
#include <numeric>

#include "fitter/evaluation/direct_light.h"
#include "fitter/export/exr_file.h"
#include "fitter/render/mlsss.h"
#include "fitter/render/surface_light.h"
#include "fitter/stages/colours.h"
#include "fitter/stages/stage_json.h"

namespace stratalux::fit {

std::vector<std::string> HeldOutLights(const PlanOptions& plan) {
  std::vector<std::string> lights = {"stripe", "white"};
  if (plan.spot_radius > 0) lights.emplace_back("spot");
  return lights;
}

Predictions Predict(const MixtureMap& map, int pool, const HeldOutView& view) {
  const SurfaceMap& surface = view.shape.surface;
  const Image<float> reflectance = SurfaceReflectance(map, surface, view.lit.light, pool),
                     part = DirectPart({view.rig, view.projector, view.exposure_ms, view.separation_period}, surface,
                                       map, pool);
  std::vector<Image<float>> subsurface = RenderSubsurface(map, surface, view.rig, view.lit, view.pyramids, {pool});
  Predictions predictions;
  for (size_t k = 0; k < view.lights.size(); ++k) {
    Prediction& p = predictions[view.lights[k]];
    p = {std::move(subsurface[k]), ReflectedLight(reflectance, view.irradiance[k]),
         ReflectedLight(part, view.irradiance[k])};
    MarkUnfitted(map, surface, pool, std::array{&p.subsurface, &p.surface, &p.direct_part});
  }
  return predictions;
}

std::vector<double> TotalWeights(const MixtureMap& map) {
  std::vector<double> totals;
  totals.reserve(static_cast<size_t>(map.profiles()));
  for (auto first = map.weight.begin(); first != map.weight.end(); first += map.layers)
    totals.push_back(std::accumulate(first, first + map.layers, 0.0));
  return totals;
}

Predictions ScaledPredictions(Predictions predictions, const MixtureMap& map, std::span<const double> of,
                              std::span<const double> to, int pool) {
  for (auto& [light, prediction] : predictions)
    for (Image<float>* image : {&prediction.subsurface, &prediction.direct_part})
      for (int j = 0; j < image->height(); ++j)
        for (int i = 0; i < image->width(); ++i)
          for (int c = 0; c < image->channels(); ++c) {
            const int64_t profile = map.ProfileOfQuad(i, j, c, pool);
            if (profile >= 0 && of[profile] > 0.0)
              (*image)(i, j, c) = static_cast<float>((*image)(i, j, c) * (to[profile] / of[profile]));
          }
  return predictions;
}

namespace {

constexpr const char* kParts[] = {"_subsurface.exr", "_surface.exr", "_direct_part.exr"};

}  // namespace

Status SavePredictions(const std::filesystem::path& folder, const Predictions& predictions) {
  nlohmann::ordered_json lights = nlohmann::ordered_json::array();
  int channels = 1;
  for (const auto& [light, p] : predictions) {
    lights.push_back(light);
    channels = p.subsurface.channels();
    const Image<float>* parts[] = {&p.subsurface, &p.surface, &p.direct_part};
    for (int k = 0; k < 3; ++k)
      SLX_RETURN_IF_ERROR(WriteExr(folder / (light + kParts[k]), *parts[k], Colours(channels)));
  }
  return WriteJson(folder / "predict.json", {{"lights", lights}, {"channels", channels}});
}

Result<Predictions> LoadPredictions(const std::filesystem::path& folder) {
  std::vector<std::string> lights;
  int channels = 1;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "predict.json", [&](const nlohmann::json& json) {
    json.at("lights").get_to(lights);
    json.at("channels").get_to(channels);
  }));
  Predictions predictions;
  for (const std::string& light : lights) {
    Prediction& p = predictions[light];
    Image<float>* parts[] = {&p.subsurface, &p.surface, &p.direct_part};
    for (int k = 0; k < 3; ++k) {
      SLX_ASSIGN_OR_RETURN(*parts[k], ReadExr(folder / (light + kParts[k]), Colours(channels)));
    }
  }
  return predictions;
}

}  // namespace stratalux::fit
