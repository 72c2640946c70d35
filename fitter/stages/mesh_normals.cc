// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/mesh_normals.h"

#include <Eigen/Core>

#include "fitter/reconstruction/mesh.h"
#include "shared/image/finite_at.h"

namespace stratalux::fit {

std::vector<std::array<float, 3>> NormalsOnMesh(const Mesh& mesh, const SurfaceMap& surface,
                                                const Image<float>& normal) {
  std::vector<std::array<float, 3>> normals = mesh.normals;
  size_t v = 0;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      if (FiniteAt(normal, i, j)) normals[v] = {normal(i, j, 0), normal(i, j, 1), normal(i, j, 2)};
      ++v;
    }
  std::vector<uint8_t> fits(normals.size(), 1);
  for (const auto& triangle : mesh.triangles) {
    const Eigen::Vector3f faces = TriangleNormal(mesh, triangle);
    for (const int32_t corner : triangle)
      if (Eigen::Map<const Eigen::Vector3f>(normals[corner].data()).dot(faces) <= 0.0F) fits[corner] = 0;
  }
  for (size_t corner = 0; corner < fits.size(); ++corner)
    if (fits[corner] == 0) normals[corner] = mesh.normals[corner];
  return normals;
}

}  // namespace stratalux::fit
