// SPDX-License-Identifier: Apache-2.0
// Normals of a mesh's vertices that are not its own: of maps on quads, with the detail or the softness of light.
#pragma once

#include <array>
#include <vector>

#include "fitter/export/triangle_mesh.h"
#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

// Of each vertex of MeshFromSurface(surface), unit. `normal`: W x H x 3, unit; the mesh's own where it is not known, or
// would point into a triangle of its vertex, as at a silhouette.
[[nodiscard]] std::vector<std::array<float, 3>> NormalsOnMesh(const Mesh& mesh, const SurfaceMap& surface,
                                                              const Image<float>& normal);

}  // namespace stratalux::fit
