// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/mesh.h"

#include <Eigen/Geometry>
#include <algorithm>

namespace stratalux::fit {
namespace {

Eigen::Vector3f Position(const Mesh& mesh, int32_t vertex) {
  return Eigen::Map<const Eigen::Vector3f>(mesh.positions_mm[vertex].data());
}

void AddTriangle(Mesh& mesh, int32_t a, int32_t b, int32_t c, double max_edge_mm) {
  if (a < 0 || b < 0 || c < 0) return;
  const Eigen::Vector3f pa = Position(mesh, a), pb = Position(mesh, b), pc = Position(mesh, c);
  if (std::max({(pa - pb).norm(), (pb - pc).norm(), (pc - pa).norm()}) > max_edge_mm) return;
  mesh.triangles.push_back({a, b, c});
}

// Corners of a cell: p00 top left, p10 top right, p01 bottom left, p11 bottom right. The camera looks along +z with y
// down, so (top left, bottom left, bottom right) turns counter-clockwise for it.
void AddCell(Mesh& mesh, int32_t p00, int32_t p10, int32_t p01, int32_t p11, double max_edge_mm) {
  if (p00 >= 0 && p11 >= 0) {
    AddTriangle(mesh, p00, p01, p11, max_edge_mm);
    AddTriangle(mesh, p00, p11, p10, max_edge_mm);
  } else {
    AddTriangle(mesh, p00, p01, p10, max_edge_mm);
    AddTriangle(mesh, p10, p01, p11, max_edge_mm);
  }
}

}  // namespace

Mesh MeshFromSurface(const SurfaceMap& surface, double max_edge_mm) {
  Mesh mesh;
  Image<int32_t> vertex(surface.width(), surface.height(), 1, -1);
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      vertex(i, j) = static_cast<int32_t>(mesh.positions_mm.size());
      mesh.positions_mm.push_back({surface.point_mm(i, j, 0), surface.point_mm(i, j, 1), surface.point_mm(i, j, 2)});
      mesh.normals.push_back({surface.normal(i, j, 0), surface.normal(i, j, 1), surface.normal(i, j, 2)});
      mesh.texture_uv.push_back({(static_cast<float>(i) + 0.5F) / static_cast<float>(surface.width()),
                                 (static_cast<float>(j) + 0.5F) / static_cast<float>(surface.height())});
    }
  for (int j = 0; j + 1 < surface.height(); ++j)
    for (int i = 0; i + 1 < surface.width(); ++i)
      AddCell(mesh, vertex(i, j), vertex(i + 1, j), vertex(i, j + 1), vertex(i + 1, j + 1), max_edge_mm);
  return mesh;
}

}  // namespace stratalux::fit
