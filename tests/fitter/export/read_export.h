// SPDX-License-Identifier: Apache-2.0
// Exported files, read by nothing that wrote them: PLY and glTF by hand, TIFF without libtiff. A file that is none is a
// failure of the test.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "shared/image/image.h"

namespace stratalux::fit {

struct PlyRead {
  std::vector<std::string> comments, properties;  // of the vertices
  std::map<std::string, std::vector<double>> columns;
  std::vector<std::array<int32_t, 3>> faces;
};
[[nodiscard]] PlyRead ReadPly(const std::filesystem::path& file);

struct GlbRead {
  nlohmann::json json;
  std::vector<std::array<float, 3>> positions, normals;
  std::vector<std::array<float, 2>> uv;        // empty: none
  std::vector<std::array<float, 4>> tangents;  // empty: none
  std::vector<std::array<uint32_t, 3>> triangles;
  std::string png, normal_png, coat_normal_png;  // bytes of the embedded pictures; empty: none
};
[[nodiscard]] GlbRead ReadGlb(const std::filesystem::path& file);

// Of vertex v, as glTF shades: with the texel (x, y, z) there, normalize(x T + y w (N x T) + z N).
[[nodiscard]] Eigen::Vector3d ShadedNormal(const GlbRead& glb, ImageView<const uint16_t> normal_texture, size_t v);

struct TiffRead {
  int width = 0, height = 0, channels = 0;
  std::vector<uint16_t> samples;
  nlohmann::json description;
};
[[nodiscard]] TiffRead ReadTiff(const std::filesystem::path& file);

// What is wrong with a glTF face as such: a size that is none of a face in metres, normals that are no unit vectors,
// triangles that turn their back to their corners' normals, bounds that are not those of the positions, tangents that
// are no unit vectors across their normals.
[[nodiscard]] std::vector<std::string> FaultsOf(const GlbRead& glb);

}  // namespace stratalux::fit
