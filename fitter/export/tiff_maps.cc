// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/tiff_maps.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include <nlohmann/json.hpp>

#include "db/interchange/image_file.h"

namespace stratalux::fit {
namespace {

using Json = nlohmann::ordered_json;
constexpr double kMost = 65535.0;
constexpr uint16_t kNoSkin = 32767;

std::string DescriptionOf(Json about, const ExportOrigin& origin) {
  about["no_surface"] = 0;
  about["frame"] = "camera: x right, y down, z forward";
  for (const auto& [name, value] : origin.Named()) about[name] = value;
  return about.dump(-1, ' ', true, Json::error_handler_t::replace);  // TIFF's strings are ASCII
}

}  // namespace

Result<DepthTiff> WriteDepthTiff(const std::filesystem::path& file, ImageView<const float> depth_mm,
                                 const ExportOrigin& origin) {
  DepthTiff made;
  double nearest_mm = std::numeric_limits<double>::infinity();
  for (const float z : depth_mm.pixels())
    if (std::isfinite(z)) nearest_mm = std::min(nearest_mm, double{z});
  if (std::isfinite(nearest_mm)) made.offset_mm = std::floor(nearest_mm) - 1.0;
  Image<uint16_t> samples(depth_mm.width(), depth_mm.height());
  for (size_t i = 0; i < samples.size(); ++i) {
    const double z_mm = depth_mm.data()[i];
    if (!std::isfinite(z_mm)) continue;
    const double sample = std::round((z_mm - made.offset_mm) / kDepthTiffStepMm);
    if (sample > kMost)
      ++made.out_of_range;
    else
      samples.pixels()[i] = static_cast<uint16_t>(sample);
  }
  const Json about = {
      {"quantity", "depth, z"}, {"unit", "mm"}, {"scale", kDepthTiffStepMm}, {"offset", made.offset_mm}};
  SLX_RETURN_IF_ERROR(db::WriteTiff16(file, samples, DescriptionOf(about, origin)));
  return made;
}

Status WriteNormalTiff(const std::filesystem::path& file, ImageView<const float> normals, const ExportOrigin& origin) {
  Image<uint16_t> samples(normals.width(), normals.height(), 3);
  for (size_t first = 0; first < samples.size(); first += 3) {
    const float* n = normals.data() + first;
    if (!std::isfinite(n[0]) || !std::isfinite(n[1]) || !std::isfinite(n[2])) continue;
    for (size_t c = 0; c < 3; ++c)
      samples.pixels()[first + c] =
          static_cast<uint16_t>(std::lround(std::clamp((n[c] + 1.0) / 2.0, 0.0, 1.0) * kMost));
  }
  const Json about = {{"quantity", "unit normal, x y z as R G B"}, {"scale", 2.0 / kMost}, {"offset", -1.0}};
  return db::WriteTiff16(file, samples, DescriptionOf(about, origin));
}

Status WriteSkinTiff(const std::filesystem::path& file, ImageView<const float> skin, const ExportOrigin& origin) {
  Image<uint16_t> samples(skin.width(), skin.height());
  for (size_t i = 0; i < samples.size(); ++i)
    if (std::isfinite(skin.data()[i])) samples.pixels()[i] = skin.data()[i] != 0.0F ? 2 * kNoSkin : kNoSkin;
  const Json about = {{"quantity", "skin: 1, other surface: 0"}, {"scale", 1.0 / kNoSkin}, {"offset", -1.0}};
  return db::WriteTiff16(file, samples, DescriptionOf(about, origin));
}

}  // namespace stratalux::fit
