// SPDX-License-Identifier: Apache-2.0
// Triangle mesh of a surface.
#pragma once

#include "fitter/export/triangle_mesh.h"
#include "fitter/reconstruction/surface_map.h"

namespace stratalux::fit {

// One vertex a known quad, its texture coordinates those of the quad's centre; cells of four quads give two triangles,
// three quads one, unless an edge is longer than `max_edge_mm` (a depth step): no triangle bridges a hole or an edge.
[[nodiscard]] Mesh MeshFromSurface(const SurfaceMap& surface, double max_edge_mm = 5.0);

}  // namespace stratalux::fit
