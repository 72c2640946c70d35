// SPDX-License-Identifier: Apache-2.0
// Triangle mesh of a surface.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>

#include "fitter/export/triangle_mesh.h"
#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

// Where the triangle faces, out of the skin; its length is twice the area.
[[nodiscard]] Eigen::Vector3f TriangleNormal(const Mesh& mesh, const std::array<int32_t, 3>& triangle);

// One vertex a known quad, its texture coordinates those of the quad's centre; cells of four quads give two triangles,
// three quads one, unless two of its corners are not OnOneSurface, or it turns its back to the normal of one: no
// triangle bridges a hole or an edge.
[[nodiscard]] Mesh MeshFromSurface(const SurfaceMap& surface);

}  // namespace stratalux::fit
