// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/detailed_mesh.h"

#include <Eigen/Core>

#include "fitter/reconstruction/mesh.h"

namespace stratalux::fit {

DetailedMesh MeshWithDetail(const SurfaceMap& surface, const Image<float>& own_normal) {
  DetailedMesh made;
  if (own_normal.empty()) {
    made.mesh = MeshFromSurface(surface);
    made.finer_normal = made.mesh.normals;
    return made;
  }
  SurfaceMap own = surface;
  own.normal = own_normal;
  made.mesh = MeshFromSurface(own);
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      if (surface.mask(i, j) != 0)
        made.finer_normal.push_back({surface.normal(i, j, 0), surface.normal(i, j, 1), surface.normal(i, j, 2)});
  std::vector<uint8_t> fits(made.finer_normal.size(), 1);
  for (const auto& triangle : made.mesh.triangles) {
    const Eigen::Vector3f faces = TriangleNormal(made.mesh, triangle);
    for (const int32_t v : triangle)
      if (Eigen::Map<const Eigen::Vector3f>(made.finer_normal[v].data()).dot(faces) <= 0.0F) fits[v] = 0;
  }
  for (size_t v = 0; v < fits.size(); ++v)
    if (fits[v] == 0) made.finer_normal[v] = made.mesh.normals[v];
  return made;
}

}  // namespace stratalux::fit
