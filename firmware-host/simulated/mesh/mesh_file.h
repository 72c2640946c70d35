// SPDX-License-Identifier: Apache-2.0
// Triangle meshes from files that strangers made: Wavefront OBJ, and PLY (ascii or binary little-endian). Strict: what
// is read is finite and its indices are there, or the refusal names the file, the place, the value and a remedy.
//
// A reader of our own, because libtinyobjloader takes a number that is none for 0 and an index that is out of range for
// a warning, and no packaged library reads both formats and says where a file is wrong.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::rig {

// Lists that triangles share; in the file's unit and axes.
struct MeshData {
  static constexpr int kNone = -1;
  struct Triangle {
    std::array<int, 3> vertex{};
    std::array<int, 3> texture = {kNone, kNone, kNone};  // kNone at one corner: at all three
    std::array<int, 3> normal = {kNone, kNone, kNone};   // likewise
  };
  std::vector<Eigen::Vector3d> vertices;  // no two are equal: those that a file repeats are one
  std::vector<Eigen::Vector2d> texture;   // (u, v), v up: (0, 0) is the picture's lower left corner
  std::vector<Eigen::Vector3d> normals;   // as the file has them: of any length
  std::vector<Triangle> triangles;        // polygons are fans around their first corner; none has two equal corners
};

// A scan of a head at 0.3 mm has 2 million triangles.
inline constexpr int64_t kMostMeshBytes = int64_t{512} << 20;
inline constexpr int64_t kMostMeshTriangles = int64_t{1} << 22;
inline constexpr int64_t kMostMeshVertices = int64_t{1} << 22;

// By the ending of its name. kUsage for all that is wrong, a missing file included: a scene names it.
[[nodiscard]] Result<MeshData> ReadMeshFile(const std::filesystem::path& file);
// `name`: what messages call it.
[[nodiscard]] Result<MeshData> ParseObj(std::string_view text, const std::string& name);
[[nodiscard]] Result<MeshData> ParsePly(std::string_view bytes, const std::string& name);

}  // namespace stratalux::rig
