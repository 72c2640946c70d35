// SPDX-License-Identifier: Apache-2.0
// Triangle mesh of a surface and its PLY file.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "fitter/reconstruction/surface_map.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct Mesh {
  std::vector<std::array<float, 3>> positions_mm;  // camera frame
  std::vector<std::array<float, 3>> normals;
  std::vector<std::array<int32_t, 3>> triangles;  // counter-clockwise as seen from outside the skin
};

// One vertex a known quad; cells of four quads give two triangles, three quads one, unless an edge is longer than
// `max_edge_mm` (a depth step).
[[nodiscard]] Mesh MeshFromSurface(const SurfaceMap& surface, double max_edge_mm = 5.0);

// Binary little-endian PLY with normals. kFailed: the file cannot be written.
Status WritePly(const std::filesystem::path& file, const Mesh& mesh);

}  // namespace stratalux::fit
