// SPDX-License-Identifier: Apache-2.0
// The mesh of a surface, and normals of its vertices with photometric detail.
#pragma once

#include <array>
#include <vector>

#include "fitter/export/triangle_mesh.h"
#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

struct DetailedMesh {
  Mesh mesh;                                       // with the surface's own normals, by which it hangs together
  std::vector<std::array<float, 3>> finer_normal;  // of each vertex, unit; its own where no detail is known or fits
};

// `surface`: its normals with detail; `own_normal` (W x H x 3): without, empty: those of `surface`. A detail that would
// point into a triangle of its vertex, as at a silhouette, is left out.
[[nodiscard]] DetailedMesh MeshWithDetail(const SurfaceMap& surface, const Image<float>& own_normal);

}  // namespace stratalux::fit
