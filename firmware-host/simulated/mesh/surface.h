// SPDX-License-Identifier: Apache-2.0
// A mesh as a smooth surface: unit normals at the corners of its triangles, and finer triangles on curved patches.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <vector>

#include "firmware-host/simulated/mesh/mesh_file.h"

namespace stratalux::rig {

// Unit normals of each triangle's corners, on the side from which its corners run counter-clockwise.
using CornerNormals = std::vector<std::array<Eigen::Vector3d, 3>>;

// The mean normal of the triangles around each vertex, weighted with their angles there (Thuermer & Wuethrich,
// "Computing vertex normals from polygonal facets", 1998): it does not depend on how faces are cut into triangles. Of a
// corner, only triangles within `crease_deg` of its own count; 180, and
// around a vertex of more than 256: all. A triangle without area has its neighbours'.
[[nodiscard]] CornerNormals AngleWeightedNormals(const MeshData& mesh, double crease_deg);
// The file's, unit; nullopt where a corner has none.
[[nodiscard]] std::optional<CornerNormals> NormalsOfFile(const MeshData& mesh);

inline constexpr int kMostSubdivisions = 4;
// Each triangle becomes 4^subdivisions on a cubic patch through its corners and across their normals (Vlachos et al.,
// "Curved PN triangles", 2001); texture coordinates are linear, normals of the file are dropped. Neighbours share the
// vertices of their edge: closed meshes stay closed.
[[nodiscard]] MeshData Subdivide(const MeshData& mesh, int subdivisions);

}  // namespace stratalux::rig
