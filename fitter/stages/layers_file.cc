// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/layers_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <nlohmann/json.hpp>

#include "fitter/export/exr_file.h"
#include "fitter/stages/colours.h"
#include "fitter/stages/reflection_json.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/formatted.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

using Json = nlohmann::ordered_json;

std::string LayersFile(const char* what) { return std::string("layers_") + what + ".exr"; }

std::vector<std::string> LayerChannels(int channels, int layers) {
  std::vector<std::string> names;
  for (const std::string& colour : Colours(channels))
    for (int l = 0; l < layers; ++l) names.push_back(Formatted("layer%02d.%s", l, colour.c_str()));
  return names;
}

// A projector that is named again is there for its row sweep.
std::vector<std::string> FloorChannels(int channels, const std::vector<int>& projectors) {
  std::vector<std::string> names;
  for (const std::string& colour : Colours(channels))
    for (auto p = projectors.begin(); p != projectors.end(); ++p) {
      const std::string axis = std::find(projectors.begin(), p, *p) == p ? "" : "rows";
      for (const char* what : {"surface", "background"}) {
        std::string name = what;
        name += std::to_string(*p);
        names.push_back(name + axis + "." + colour);
      }
    }
  return names;
}

std::vector<std::string> QualityChannels(int channels) {
  std::vector<std::string> names;
  for (const std::string& colour : Colours(channels))
    for (const char* what : {"divergence.", "iterations.", "reason."}) names.push_back(what + colour);
  return names;
}

// What a later program may do without is written after what it needs.
std::vector<std::string> AllQualityChannels(int channels) {
  std::vector<std::string> names = QualityChannels(channels);
  for (const char* what : {"signal_to_noise.", "prior_share."})
    for (const std::string& colour : Colours(channels)) names.push_back(what + colour);
  return names;
}

// 2: the surface has a curve over GGX and hairs, which a reader of schema 1 would leave out; 3: and a gloss.
constexpr int kLayersSchema = 3;

using LayerField = std::pair<const char*, std::vector<float> MixtureMap::*>;
constexpr std::array<LayerField, 3> kLayerFields = {
    {{"weight", &MixtureMap::weight}, {"depth_mm", &MixtureMap::depth_mm}, {"sigma_mm", &MixtureMap::sigma_mm}}};

Image<float> FloorOf(const MixtureMap& map) {
  const int lights = static_cast<int>(map.training_projectors.size());
  Image<float> floor(map.width, map.height, 2 * map.channels * lights);
  for (int64_t i = 0; i < map.profiles(); ++i)
    for (int p = 0; p < lights; ++p) {
      floor.data()[2 * (i * lights + p)] = map.surface[i * lights + p];
      floor.data()[2 * (i * lights + p) + 1] = map.background[i * lights + p];
    }
  return floor;
}

Image<float> QualityOf(const FittedLayers& layers) {
  const MixtureMap& map = layers.map;
  const int colours = map.channels;
  Image<float> quality(map.width, map.height, 5 * colours);
  for (int64_t i = 0; i < map.profiles(); ++i) {
    const int64_t colour = i % colours, pixel = i / colours;
    float* values = quality.data() + pixel * 5 * colours;
    values[3 * colour] = map.divergence[i];
    values[3 * colour + 1] = map.iterations[i];
    values[3 * colour + 2] = map.reason[i];
    values[3 * colours + colour] = layers.signal_to_noise.pixels()[i];
    values[4 * colours + colour] = map.prior_share.empty() ? 0.0F : map.prior_share[i];
  }
  return quality;
}

}  // namespace

Status SaveLayers(const std::filesystem::path& folder, const FittedLayers& layers) {
  const MixtureMap& map = layers.map;
  SLX_RETURN_IF_ERROR(ParallelTry(kLayerFields.size() + 2, [&](size_t k) {
    if (k == kLayerFields.size())
      return WriteExr(folder / "floor.exr", FloorOf(map), FloorChannels(map.channels, map.training_projectors));
    if (k > kLayerFields.size())
      return WriteExr(folder / "quality.exr", QualityOf(layers), AllQualityChannels(map.channels));
    const auto& [name, field] = kLayerFields[k];
    // [pixel][colour][layer] is an image's own order.
    const ImageView<const float> image((map.*field).data(), map.width, map.height, map.channels * map.layers);
    return WriteExr(folder / LayersFile(name), image, LayerChannels(map.channels, map.layers));
  }));
  const ScatteringModel& model = map.scattering;
  const Json json = {{"schema", kLayersSchema},
                     {"layers", map.layers},
                     {"channels", map.channels},
                     {"pool", layers.pool},
                     {"shift_law", ToString(model.shift_law)},
                     {"eta", model.eta},
                     {"tau", model.tau},
                     {"gain", model.gain_model ? "model" : "none"},
                     {"directional",
                      {{"kappa_per_mm", model.directional.kappa_per_mm},
                       {"phase_slope", model.directional.phase_slope},
                       {"sigma_0_mm", model.directional.sigma_0_mm}}},
                     {"surface", ReflectionJson(model.reflection)},
                     {"training_projectors", map.training_projectors},
                     {"prior_photons", map.prior_photons},
                     {"session_photons", map.session_photons}};
  return WriteJson(folder / "layers.json", json);
}

namespace {

Status ReadDescription(const std::filesystem::path& folder, FittedLayers& layers) {
  const std::filesystem::path description = folder / "layers.json";
  if (std::error_code error; !std::filesystem::exists(description, error))
    return Status::NotFound("no fit in " + folder.string() + " (`stratalux-fit run` or `fit` makes one)");
  MixtureMap& map = layers.map;
  ScatteringModel& model = map.scattering;
  int schema = 0;
  std::string law;
  SLX_RETURN_IF_ERROR(ReadJson(description, [&](const nlohmann::json& json) {
    if (json.at("schema").get_to(schema) > kLayersSchema) return;
    json.at("layers").get_to(map.layers);
    json.at("channels").get_to(map.channels);
    json.at("pool").get_to(layers.pool);
    json.at("shift_law").get_to(law);
    json.at("eta").get_to(model.eta);
    json.at("tau").get_to(model.tau);
    model.gain_model = json.at("gain").get<std::string>() == "model";
    if (json.contains("directional")) {
      const auto& d = json.at("directional");
      model.directional = {d.at("kappa_per_mm"), d.at("phase_slope"), d.at("sigma_0_mm")};
    }
    if (json.contains("surface")) model.reflection = ReflectionFrom(json.at("surface"));
    json.at("training_projectors").get_to(map.training_projectors);
    map.prior_photons = json.value("prior_photons", 0.0);
    map.session_photons = json.value("session_photons", 0.0);
  }));
  if (schema > kLayersSchema)
    return Status(StatusCode::kNewerSchema, description.string() + ": schema " + std::to_string(schema) +
                                                ", this program reads up to " + std::to_string(kLayersSchema));
  SLX_ASSIGN_OR_RETURN(model.shift_law, ParseShiftLaw(law).WithContext(description.string()));
  if (map.layers < 1 || map.layers > 32 || (map.channels != 1 && map.channels != 3) || layers.pool < 1 ||
      layers.pool > 16 || map.training_projectors.empty())
    return Status::Integrity(description.string() + ": a value is out of range");
  return Status::Ok();
}

Status ReadQuality(const std::filesystem::path& folder, FittedLayers& layers) {
  MixtureMap& map = layers.map;
  const int colours = map.channels;
  SLX_ASSIGN_OR_RETURN(const auto quality, ReadExr(folder / "quality.exr", AllQualityChannels(colours)));
  if (quality.width() != map.width || quality.height() != map.height)
    return Status::Integrity(folder.string() + ": its maps differ in size; fit again");
  layers.signal_to_noise = Image<float>(map.width, map.height, colours);
  for (int64_t i = 0; i < map.profiles(); ++i) {
    const int64_t colour = i % colours;
    const float* values = quality.data() + i / colours * 5 * colours;
    map.divergence.push_back(values[3 * colour]);
    map.iterations.push_back(static_cast<uint16_t>(values[3 * colour + 1]));
    const float reason = values[3 * colour + 2];
    if (!(reason >= 0.0F && reason < static_cast<float>(kFitReasons)))
      return Status::Integrity((folder / "quality.exr").string() + ": a reason is out of range");
    map.reason.push_back(static_cast<uint8_t>(reason));
    layers.signal_to_noise.pixels()[i] = values[3 * colours + colour];
    if (map.prior_photons > 0.0) map.prior_share.push_back(values[4 * colours + colour]);
  }
  return Status::Ok();
}

}  // namespace

Result<FittedLayers> LoadLayers(const std::filesystem::path& folder) {
  FittedLayers layers;
  SLX_RETURN_IF_ERROR(ReadDescription(folder, layers));
  MixtureMap& map = layers.map;
  std::array<Image<float>, kLayerFields.size()> fields;
  Image<float> floor;
  SLX_RETURN_IF_ERROR(ParallelTry(kLayerFields.size() + 1, [&](size_t k) -> Status {
    if (k == kLayerFields.size()) {
      SLX_ASSIGN_OR_RETURN(floor, ReadExr(folder / "floor.exr", FloorChannels(map.channels, map.training_projectors)));
      return Status::Ok();
    }
    SLX_ASSIGN_OR_RETURN(fields[k],
                         ReadExr(folder / LayersFile(kLayerFields[k].first), LayerChannels(map.channels, map.layers)));
    return Status::Ok();
  }));
  map.width = fields[0].width();
  map.height = fields[0].height();
  for (size_t k = 0; k < fields.size(); ++k) map.*kLayerFields[k].second = std::move(fields[k]).TakePixels();
  const size_t values = static_cast<size_t>(map.profiles()) * static_cast<size_t>(map.layers);
  if (map.depth_mm.size() != values || map.sigma_mm.size() != values || map.weight.size() != values ||
      floor.width() != map.width || floor.height() != map.height)
    return Status::Integrity(folder.string() + ": its maps differ in size; fit again");
  for (size_t i = 0; i < floor.size(); i += 2) {
    map.surface.push_back(floor.pixels()[i]);
    map.background.push_back(floor.pixels()[i + 1]);
  }
  if (!map.scattering.reflection.gloss.IsOf({map.width, map.height, map.channels}))
    return Status::Integrity((folder / "layers.json").string() + ": its gloss is not of this map; fit again");
  SLX_RETURN_IF_ERROR(ReadQuality(folder, layers));
  return layers;
}

std::vector<int> DistinctProjectors(const MixtureMap& map) {
  std::vector<int> projectors = map.training_projectors;
  std::sort(projectors.begin(), projectors.end());
  projectors.erase(std::unique(projectors.begin(), projectors.end()), projectors.end());
  return projectors;
}

std::string ProvenanceOf(const MixtureMap& map, int projectors) {
  constexpr const char* kNumbers[] = {"no", "one", "two", "three", "four", "five", "six"};
  const std::vector<int> used = DistinctProjectors(map);
  std::string text = "from " +
                     (used.size() < std::size(kNumbers) ? kNumbers[used.size()] : std::to_string(used.size())) +
                     (used.size() == 1 ? " projector" : " projectors");
  for (int p = 0; p < projectors; ++p)
    if (std::find(used.begin(), used.end(), p) == used.end()) text += ", projector " + std::to_string(p) + " held out";
  return text;
}

Result<SavedFit> LoadFit(const std::filesystem::path& folder, LayerChoice choice) {
  std::error_code error;
  const bool has_maps = std::filesystem::exists(folder / kMapsFolder, error);
  if (choice == LayerChoice::kMaps && !has_maps)
    return Status::NotFound(
        folder.string() +
        " has no maps from all projectors: `stratalux-fit run` with `--maps on` makes them; `--maps "
        "off` takes the layers of the fit itself");
  const bool maps = choice != LayerChoice::kFit && has_maps;
  SLX_ASSIGN_OR_RETURN(auto layers, LoadLayers(maps ? folder / kMapsFolder : folder));
  SavedFit fit{{}, std::move(layers.map), layers.pool, {}};
  if (!std::filesystem::exists(folder / "shape.json", error))
    return Status::NotFound(folder.string() +
                            " is of an older program and lacks shape.json; `stratalux-fit run` fits again");
  SLX_ASSIGN_OR_RETURN(fit.shape, LoadShape(folder));
  fit.provenance = ProvenanceOf(fit.map, static_cast<int>(fit.shape.record.projectors.size()));
  const SurfaceMap& surface = fit.shape.surface;
  if (surface.width() / fit.pool != fit.map.width || surface.height() / fit.pool != fit.map.height)
    return Status::Integrity(folder.string() + ": its maps differ in size; fit again");
  return fit;
}

}  // namespace stratalux::fit
