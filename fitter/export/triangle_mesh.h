// SPDX-License-Identifier: Apache-2.0
// A surface as triangles, and as points with what is known of their place: what the files of this folder are made of.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace stratalux::fit {

struct Mesh {
  std::vector<std::array<float, 3>> positions_mm;  // camera frame
  std::vector<std::array<float, 3>> normals;       // unit, out of the surface
  std::vector<std::array<float, 2>> texture_uv;    // 0 .. 1 over the picture of quads, (0, 0) its top left corner
  std::vector<std::array<uint8_t, 3>> colours;     // sRGB; empty: none
  std::vector<std::array<float, 4>> tangents;      // of glTF: unit, across the normal, w = 1 or -1; empty: none
  std::vector<std::array<int32_t, 3>> triangles;   // counter-clockwise as seen from outside the skin
};

struct PointCloud {
  std::vector<std::array<float, 3>> positions_mm;    // camera frame
  std::vector<std::array<float, 3>> normals;         // unit, out of the surface
  std::vector<float> normal_sigma_rad;               // both tilts together; NaN where not known
  std::vector<std::array<float, 6>> covariance_mm2;  // of the position: xx xy xz yy yz zz
  std::vector<std::array<uint8_t, 3>> colours;       // sRGB; empty: none
  std::vector<uint8_t> skin;                         // 1: skin, 0: hair, eyes or else; empty: not told
};

}  // namespace stratalux::fit
