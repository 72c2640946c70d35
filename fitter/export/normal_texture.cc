// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/normal_texture.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

namespace stratalux::fit {
namespace {

Eigen::Vector3d VectorOf(const std::array<float, 3>& v) { return {v[0], v[1], v[2]}; }

// `v` laid into the plane across `normal`, unit; zero where nothing is left.
Eigen::Vector3d Across(const Eigen::Vector3d& normal, const Eigen::Vector3d& v) {
  const Eigen::Vector3d across = v - normal.dot(v) * normal;
  return across.norm() > 0.0 ? across.normalized() : Eigen::Vector3d::Zero();
}

struct TriangleFrame {
  Eigen::Vector3d along_u;
  double orientation;  // 1: the picture is seen from outside as it is; -1: mirrored
};

// With edges e1, e2 from corner 0 and what u, v differ by along them, x = x0 + u dx/du + v dx/dv gives
//   dx/du = (dv2 e1 - dv1 e2) / (du1 dv2 - du2 dv1)
TriangleFrame FrameOf(const Mesh& mesh, const std::array<int32_t, 3>& t) {
  const auto uv = [&](int k) { return Eigen::Vector2d(mesh.texture_uv[t[k]][0], mesh.texture_uv[t[k]][1]); };
  const auto at = [&](int k) { return VectorOf(mesh.positions_mm[t[k]]); };
  const Eigen::Vector2d d1 = uv(1) - uv(0), d2 = uv(2) - uv(0);
  const double area = d1.x() * d2.y() - d2.x() * d1.y();
  const double sign = area < 0.0 ? -1.0 : 1.0;
  // v runs down the picture: what turns left as seen from outside has a negative area.
  return {sign * (d2.y() * (at(1) - at(0)) - d1.y() * (at(2) - at(0))), -sign};
}

// Of the triangle at its corner k, both edges across the corner's normal.
double AngleAt(const Mesh& mesh, const std::array<int32_t, 3>& t, int k) {
  const auto at = [&](int c) { return VectorOf(mesh.positions_mm[t[c % 3]]); };
  const Eigen::Vector3d normal = VectorOf(mesh.normals[t[k]]);
  const double cosine = Across(normal, at(k + 1) - at(k)).dot(Across(normal, at(k + 2) - at(k)));
  return std::acos(std::clamp(cosine, -1.0, 1.0));
}

std::array<float, 4> TangentOf(const Eigen::Vector3d& normal, const Eigen::Vector3d& sum, double orientation) {
  Eigen::Vector3d tangent = Across(normal, sum);
  if (tangent.isZero()) tangent = normal.unitOrthogonal();
  return {static_cast<float>(tangent.x()), static_cast<float>(tangent.y()), static_cast<float>(tangent.z()),
          orientation < 0.0 ? -1.0F : 1.0F};
}

}  // namespace

std::vector<std::array<float, 4>> TangentsOf(const Mesh& mesh) {
  std::vector<Eigen::Vector3d> sums(mesh.positions_mm.size(), Eigen::Vector3d::Zero());
  std::vector<double> orientations(mesh.positions_mm.size(), 0.0);
  for (const auto& triangle : mesh.triangles) {
    const TriangleFrame frame = FrameOf(mesh, triangle);
    for (int k = 0; k < 3; ++k) {
      const auto v = static_cast<size_t>(triangle[k]);
      const double angle = AngleAt(mesh, triangle, k);
      sums[v] += angle * Across(VectorOf(mesh.normals[v]), frame.along_u);
      orientations[v] += angle * frame.orientation;
    }
  }
  std::vector<std::array<float, 4>> tangents;
  tangents.reserve(sums.size());
  for (size_t v = 0; v < sums.size(); ++v)
    tangents.push_back(TangentOf(VectorOf(mesh.normals[v]), sums[v], orientations[v]));
  return tangents;
}

Image<uint8_t> NormalTexture(const Mesh& mesh, std::span<const std::array<float, 3>> finer, int width, int height) {
  Image<uint8_t> texture(width, height, 3, 128);
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) texture(i, j, 2) = 255;
  for (size_t v = 0; v < mesh.normals.size(); ++v) {
    const Eigen::Vector3d normal = VectorOf(mesh.normals[v]), fine = VectorOf(finer[v]);
    // Equal but for what single precision leaves of normalising them.
    if ((fine - normal).norm() < 8.0 * std::numeric_limits<float>::epsilon()) continue;
    const auto& t = mesh.tangents[v];
    const Eigen::Vector3d tangent(t[0], t[1], t[2]);
    const Eigen::Vector3d in_tangent_space(fine.dot(tangent), fine.dot(t[3] * normal.cross(tangent)), fine.dot(normal));
    if (!(in_tangent_space.z() > 0.0)) continue;
    const int i = static_cast<int>(mesh.texture_uv[v][0] * static_cast<float>(width)),
              j = static_cast<int>(mesh.texture_uv[v][1] * static_cast<float>(height));
    for (int c = 0; c < 3; ++c)
      texture(i, j, c) = static_cast<uint8_t>(std::lround((std::clamp(in_tangent_space[c], -1.0, 1.0) + 1.0) * 127.5));
  }
  return texture;
}

}  // namespace stratalux::fit
