// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/saved_fit.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>

#include <nlohmann/json.hpp>

#include "fitter/pipeline/exr_file.h"
#include "fitter/reconstruction/mesh.h"

namespace stratalux::fit {
namespace {

using Json = nlohmann::ordered_json;

std::vector<std::string> Colours(int channels) {
  return channels == 1 ? std::vector<std::string>{"Y"} : std::vector<std::string>{"R", "G", "B"};
}

std::string LayersFile(const char* what) { return std::string("layers_") + what + ".exr"; }

std::vector<std::string> LayerChannels(int channels, int layers) {
  std::vector<std::string> names;
  for (const std::string& colour : Colours(channels))
    for (int l = 0; l < layers; ++l) {
      char text[32];
      std::snprintf(text, sizeof text, "layer%02d.%s", l, colour.c_str());
      names.push_back(text);
    }
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

}  // namespace

Status WriteMaps(const std::filesystem::path& folder, const FaceGeometry& face, const SurfaceMap& surface) {
  SLX_RETURN_IF_ERROR(WriteExr(folder / "position.exr", surface.point_mm, {"X", "Y", "Z"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "depth_sigma.exr", surface.depth_sigma_mm, {"Y"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "normal_surface.exr", surface.normal, {"X", "Y", "Z"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "normal_photometric.exr", face.photometric.normal, {"X", "Y", "Z"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "normal_fused.exr", face.fused_normal, {"X", "Y", "Z"}));
  SLX_RETURN_IF_ERROR(
      WriteExr(folder / "albedo.exr", face.photometric.albedo, Colours(face.photometric.albedo.channels())));
  for (size_t p = 0; p < face.separation.size(); ++p) {
    const std::string number = std::to_string(p) + ".exr";
    const auto colours = Colours(face.separation[p].direct.channels());
    SLX_RETURN_IF_ERROR(WriteExr(folder / ("direct_" + number), face.separation[p].direct, colours));
    SLX_RETURN_IF_ERROR(WriteExr(folder / ("global_" + number), face.separation[p].global, colours));
  }
  return WritePly(folder / "mesh.ply", MeshFromSurface(surface));
}

Status WriteLayers(const std::filesystem::path& folder, const MixtureMap& map, const Image<float>& signal_to_noise,
                   int pool) {
  for (const auto& [name, values] :
       {std::pair("weight", &map.weight), {"depth_mm", &map.depth_mm}, {"sigma_mm", &map.sigma_mm}}) {
    Image<float> image(map.width, map.height, map.channels * map.layers);
    std::copy(values->begin(), values->end(), image.data());  // [pixel][colour][layer] is the image's own order
    SLX_RETURN_IF_ERROR(WriteExr(folder / LayersFile(name), image, LayerChannels(map.channels, map.layers)));
  }
  const int lights = static_cast<int>(map.training_projectors.size());
  Image<float> floor(map.width, map.height, 2 * map.channels * lights);
  for (int64_t i = 0; i < map.profiles(); ++i)
    for (int p = 0; p < lights; ++p) {
      floor.data()[2 * (i * lights + p)] = map.surface[i * lights + p];
      floor.data()[2 * (i * lights + p) + 1] = map.background[i * lights + p];
    }
  SLX_RETURN_IF_ERROR(WriteExr(folder / "floor.exr", floor, FloorChannels(map.channels, map.training_projectors)));
  const int colours = map.channels;
  Image<float> quality(map.width, map.height, 5 * colours);
  for (int64_t i = 0; i < map.profiles(); ++i) {
    const int64_t colour = i % colours, pixel = i / colours;
    float* values = quality.data() + pixel * 5 * colours;
    values[3 * colour] = map.divergence[i];
    values[3 * colour + 1] = map.iterations[i];
    values[3 * colour + 2] = map.reason[i];
    values[3 * colours + colour] = signal_to_noise.pixels()[i];
    values[4 * colours + colour] = map.prior_share.empty() ? 0.0F : map.prior_share[i];
  }
  SLX_RETURN_IF_ERROR(WriteExr(folder / "quality.exr", quality, AllQualityChannels(colours)));
  const Json json = {{"schema", 1},
                     {"layers", map.layers},
                     {"channels", map.channels},
                     {"pool", pool},
                     {"shift_law", ToString(map.shift_law)},
                     {"eta", map.eta},
                     {"tau", map.tau},
                     {"gain", map.gain_model ? "model" : "none"},
                     {"directional",
                      {{"kappa_per_mm", map.directional.kappa_per_mm},
                       {"phase_slope", map.directional.phase_slope},
                       {"sigma_0_mm", map.directional.sigma_0_mm}}},
                     {"surface", map.reflection.Known() ? Json{{"strength", map.reflection.strength},
                                                               {"roughness", map.reflection.roughness}}
                                                        : Json()},
                     {"training_projectors", map.training_projectors}};
  std::ofstream out(folder / "layers.json", std::ios::trunc);
  out << json.dump(1) << '\n';
  out.flush();
  return out ? Status::Ok() : Status::Failed("cannot write " + (folder / "layers.json").string());
}

Result<SavedFit> LoadFit(const std::filesystem::path& folder) {
  const std::filesystem::path description = folder / "layers.json";
  std::ifstream in(description);
  if (!in) return Status::NotFound("no fit in " + folder.string() + " (`stratalux-fit run` or `fit` makes one)");
  SavedFit fit;
  MixtureMap& map = fit.map;
  try {
    const Json json = Json::parse(in);
    if (const int schema = json.at("schema").get<int>(); schema > 1)
      return Status(StatusCode::kNewerSchema,
                    description.string() + ": schema " + std::to_string(schema) + ", this program reads up to 1");
    map.layers = json.at("layers");
    map.channels = json.at("channels");
    fit.pool = json.at("pool");
    SLX_ASSIGN_OR_RETURN(map.shift_law, ParseShiftLaw(json.at("shift_law")));
    map.eta = json.at("eta");
    map.tau = json.at("tau");
    map.gain_model = json.at("gain").get<std::string>() == "model";
    if (json.contains("directional")) {
      const Json& d = json.at("directional");
      map.directional = {d.at("kappa_per_mm"), d.at("phase_slope"), d.at("sigma_0_mm")};
    }
    if (json.contains("surface") && !json.at("surface").is_null())
      map.reflection = {json.at("surface").at("strength"), json.at("surface").at("roughness")};
    map.training_projectors = json.at("training_projectors").get<std::vector<int>>();
    if (map.layers < 1 || map.layers > 32 || (map.channels != 1 && map.channels != 3) || fit.pool < 1 ||
        fit.pool > 16 || map.training_projectors.empty())
      return Status::Integrity(description.string() + ": a value is out of range");
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(description.string() + ": " + error.what());
  }
  const auto layer_channels = LayerChannels(map.channels, map.layers);
  for (const auto& [name, values] :
       {std::pair("weight", &map.weight), {"depth_mm", &map.depth_mm}, {"sigma_mm", &map.sigma_mm}}) {
    SLX_ASSIGN_OR_RETURN(const auto image, ReadExr(folder / LayersFile(name), layer_channels));
    map.width = image.width();
    map.height = image.height();
    values->assign(image.pixels().begin(), image.pixels().end());
  }
  SLX_ASSIGN_OR_RETURN(const auto floor,
                       ReadExr(folder / "floor.exr", FloorChannels(map.channels, map.training_projectors)));
  SLX_ASSIGN_OR_RETURN(const auto quality, ReadExr(folder / "quality.exr", QualityChannels(map.channels)));
  SLX_ASSIGN_OR_RETURN(fit.surface.point_mm, ReadExr(folder / "position.exr", {"X", "Y", "Z"}));
  SLX_ASSIGN_OR_RETURN(fit.surface.normal, ReadExr(folder / "normal_surface.exr", {"X", "Y", "Z"}));
  SLX_ASSIGN_OR_RETURN(fit.surface.depth_sigma_mm, ReadExr(folder / "depth_sigma.exr", {"Y"}));
  const size_t profiles = static_cast<size_t>(map.profiles()), layers = static_cast<size_t>(map.layers);
  auto same_size = [](const Image<float>& image, int width, int height) {
    return image.width() == width && image.height() == height;
  };
  const int width = fit.surface.point_mm.width(), height = fit.surface.point_mm.height();
  const bool together = map.depth_mm.size() == profiles * layers && map.sigma_mm.size() == profiles * layers &&
                        map.weight.size() == profiles * layers && same_size(floor, map.width, map.height) &&
                        same_size(quality, map.width, map.height) && width / fit.pool == map.width &&
                        height / fit.pool == map.height && same_size(fit.surface.normal, width, height) &&
                        same_size(fit.surface.depth_sigma_mm, width, height);
  if (!together) return Status::Integrity(folder.string() + ": its maps differ in size; fit again");
  for (size_t i = 0; i < floor.size(); i += 2) {
    map.surface.push_back(floor.pixels()[i]);
    map.background.push_back(floor.pixels()[i + 1]);
  }
  for (size_t i = 0; i < quality.size(); i += 3) {
    map.divergence.push_back(quality.pixels()[i]);
    map.iterations.push_back(static_cast<uint16_t>(quality.pixels()[i + 1]));
    const float reason = quality.pixels()[i + 2];
    if (!(reason >= 0.0F && reason < static_cast<float>(kFitReasons)))
      return Status::Integrity((folder / "quality.exr").string() + ": a reason is out of range");
    map.reason.push_back(static_cast<uint8_t>(reason));
  }
  fit.surface.mask = Image<uint8_t>(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      fit.surface.mask(x, y) =
          std::isfinite(fit.surface.point_mm(x, y, 2)) && std::isfinite(fit.surface.normal(x, y, 2)) ? 1 : 0;
  return fit;
}

}  // namespace stratalux::fit
