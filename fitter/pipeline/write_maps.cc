// SPDX-License-Identifier: Apache-2.0
#include <cstdio>

#include "fitter/pipeline/exr_file.h"
#include "fitter/pipeline/run.h"
#include "fitter/reconstruction/mesh.h"

namespace stratalux::fit {
namespace {

std::vector<std::string> Colours(int channels) {
  return channels == 1 ? std::vector<std::string>{"Y"} : std::vector<std::string>{"R", "G", "B"};
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

Status WriteLayers(const std::filesystem::path& folder, const MixtureMap& map) {
  const auto colours = Colours(map.channels);
  for (const auto& [name, values] :
       {std::pair("weight", &map.weight), {"depth_mm", &map.depth_mm}, {"sigma_mm", &map.sigma_mm}}) {
    Image<float> image(map.width, map.height, map.channels * map.layers);
    std::copy(values->begin(), values->end(), image.data());  // [pixel][colour][layer] is the image's own order
    std::vector<std::string> channels;
    for (const std::string& colour : colours)
      for (int l = 0; l < map.layers; ++l) {
        char text[32];
        std::snprintf(text, sizeof text, "layer%02d.%s", l, colour.c_str());
        channels.push_back(text);
      }
    SLX_RETURN_IF_ERROR(WriteExr(folder / (std::string("layers_") + name + ".exr"), image, channels));
  }
  Image<float> quality(map.width, map.height, 3 * map.channels);
  for (int64_t i = 0; i < map.profiles(); ++i) {
    quality.data()[3 * i] = map.divergence[i];
    quality.data()[3 * i + 1] = map.iterations[i];
    quality.data()[3 * i + 2] = map.reason[i];
  }
  std::vector<std::string> channels;
  for (const std::string& colour : colours)
    for (const char* what : {"divergence.", "iterations.", "reason."}) channels.push_back(what + colour);
  return WriteExr(folder / "quality.exr", quality, channels);
}

}  // namespace stratalux::fit
