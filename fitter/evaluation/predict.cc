// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/predict.h"

#include <array>
#include <cmath>
#include <numeric>
#include <utility>

#include "fitter/evaluation/direct_light.h"
#include "fitter/export/exr_file.h"
#include "fitter/image/pixelwise.h"
#include "fitter/render/mlsss.h"
#include "fitter/render/surface_light.h"
#include "fitter/stages/colours.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {

std::vector<std::string> HeldOutLights(const PlanOptions& plan) {
  std::vector<std::string> lights = {"stripe", "white"};
  if (plan.spot_radius > 0) lights.emplace_back("spot");
  return lights;
}

namespace {

// A share of what falls on the prediction's surface; what was not fitted stays unknown.
Image<float> ShareUnder(const Prediction& p, const Image<float>& share, const std::string& light,
                        const Image<float>& on_judged) {
  const auto own = p.own_irradiance.find(light);
  Image<float> image = ReflectedLight(share, own == p.own_irradiance.end() ? on_judged : own->second);
  const Image<float>& subsurface = p.subsurface.at(light);
  for (size_t i = 0; i < image.size(); ++i)
    if (std::isnan(subsurface.pixels()[i])) image.pixels()[i] = std::nanf("");
  return image;
}

}  // namespace

Image<float> Prediction::SurfaceLight(const std::string& light, const Image<float>& irradiance) const {
  return ShareUnder(*this, reflectance, light, irradiance);
}

Image<float> Prediction::DirectLight(const std::string& light, const Image<float>& irradiance) const {
  return ShareUnder(*this, direct_share, light, irradiance);
}

Image<float> Prediction::AllLight(const std::string& light, const Image<float>& irradiance) const {
  return Sum(subsurface.at(light), SurfaceLight(light, irradiance));
}

Prediction Predict(const MixtureMap& of_shape, int pool, const HeldOutView& view) {
  const auto on_view = ProfilesOnView(view, pool, of_shape.channels);
  const MixtureMap carried = on_view.empty() ? MixtureMap() : ProfilesOf(of_shape, on_view);
  const MixtureMap& map = on_view.empty() ? of_shape : carried;
  const SurfaceMap& surface = view.shape.surface;
  Prediction prediction;
  prediction.reflectance = SurfaceReflectance(map, surface, view.lit.light, pool);
  prediction.direct_share = DirectShare(SinusoidsOf(view), surface, map, prediction.reflectance, pool);
  std::vector<Image<float>> subsurface = RenderSubsurface(map, surface, view.rig, view.lit, view.pyramids, {pool});
  for (size_t k = 0; k < view.lights.size(); ++k) {
    MarkUnfitted(map, surface, pool, std::array{&subsurface[k]});
    prediction.subsurface[view.lights[k]] = std::move(subsurface[k]);
  }
  return prediction;
}

std::vector<double> TotalWeights(const MixtureMap& map) {
  std::vector<double> totals;
  totals.reserve(static_cast<size_t>(map.profiles()));
  for (auto first = map.weight.begin(); first != map.weight.end(); first += map.layers)
    totals.push_back(std::accumulate(first, first + map.layers, 0.0));
  return totals;
}

Prediction ScaledPrediction(Prediction prediction, const MixtureMap& map, std::span<const double> of,
                            std::span<const double> to, int pool, std::span<const int64_t> on_view) {
  std::vector<Image<float>*> images = {&prediction.direct_share};
  for (auto& [light, image] : prediction.subsurface) images.push_back(&image);
  for (Image<float>* image : images)
    for (int j = 0; j < image->height(); ++j)
      for (int i = 0; i < image->width(); ++i)
        for (int c = 0; c < image->channels(); ++c) {
          int64_t profile = map.ProfileOfQuad(i, j, c, pool);
          if (profile >= 0 && !on_view.empty()) profile = on_view[static_cast<size_t>(profile)];
          if (profile >= 0 && of[profile] > 0.0)
            (*image)(i, j, c) = static_cast<float>((*image)(i, j, c) * (to[profile] / of[profile]));
        }
  return prediction;
}

namespace {

constexpr const char *kSubsurface = "_subsurface.exr", *kIrradiance = "_irradiance.exr",
                     *kReflectance = "reflectance.exr", *kDirectShare = "direct_share.exr";

}  // namespace

Status SavePrediction(const std::filesystem::path& folder, const Prediction& prediction) {
  nlohmann::ordered_json lights = nlohmann::ordered_json::array();
  const int channels = prediction.reflectance.channels();
  std::vector<std::pair<std::string, const Image<float>*>> files = {{kReflectance, &prediction.reflectance},
                                                                    {kDirectShare, &prediction.direct_share}};
  for (const auto& [light, image] : prediction.subsurface) {
    lights.push_back(light);
    files.emplace_back(light + kSubsurface, &image);
  }
  for (const auto& [light, image] : prediction.own_irradiance) files.emplace_back(light + kIrradiance, &image);
  SLX_RETURN_IF_ERROR(ParallelTry(
      files.size(), [&](size_t k) { return WriteExr(folder / files[k].first, *files[k].second, Colours(channels)); }));
  return WriteJson(folder / "predict.json", {{"lights", lights}, {"channels", channels}});
}

Result<Prediction> LoadPrediction(const std::filesystem::path& folder) {
  std::vector<std::string> lights;
  int channels = 1;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "predict.json", [&](const nlohmann::json& json) {
    json.at("lights").get_to(lights);
    json.at("channels").get_to(channels);
  }));
  const std::vector<std::string> colours = Colours(channels);
  Prediction prediction;
  for (const std::string& light : lights) {
    SLX_ASSIGN_OR_RETURN(prediction.subsurface[light], ReadExr(folder / (light + kSubsurface), colours));
    const std::filesystem::path own = folder / (light + kIrradiance);
    if (std::error_code error; !std::filesystem::exists(own, error)) continue;
    SLX_ASSIGN_OR_RETURN(prediction.own_irradiance[light], ReadExr(own, colours));
  }
  SLX_ASSIGN_OR_RETURN(prediction.reflectance, ReadExr(folder / kReflectance, colours));
  SLX_ASSIGN_OR_RETURN(prediction.direct_share, ReadExr(folder / kDirectShare, colours));
  return prediction;
}

}  // namespace stratalux::fit
