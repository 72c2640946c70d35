// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/mesh.h"

#include <algorithm>
#include <array>
#include <utility>

#include "fitter/reconstruction/surface_links.h"

namespace stratalux::fit {
namespace {

using Quad = std::array<int, 2>;

class MeshBuilder {
 public:
  explicit MeshBuilder(const SurfaceMap& surface)
      : surface_(surface), links_(surface), vertex_(surface.width(), surface.height(), 1, -1) {}

  void AddVertex(int i, int j) {
    vertex_(i, j) = static_cast<int32_t>(mesh.positions_mm.size());
    mesh.positions_mm.push_back({surface_.point_mm(i, j, 0), surface_.point_mm(i, j, 1), surface_.point_mm(i, j, 2)});
    mesh.normals.push_back({surface_.normal(i, j, 0), surface_.normal(i, j, 1), surface_.normal(i, j, 2)});
    mesh.texture_uv.push_back({(static_cast<float>(i) + 0.5F) / static_cast<float>(surface_.width()),
                               (static_cast<float>(j) + 0.5F) / static_cast<float>(surface_.height())});
  }

  // The camera looks along +z with y down, so (top left, bottom left, bottom right) turns counter-clockwise for it.
  void AddCell(int i, int j) {
    const Quad top_left = {i, j}, top_right = {i + 1, j}, bottom_left = {i, j + 1}, bottom_right = {i + 1, j + 1};
    if (Vertex(top_left) >= 0 && Vertex(bottom_right) >= 0) {
      AddTriangle(top_left, bottom_left, bottom_right);
      AddTriangle(top_left, bottom_right, top_right);
    } else {
      AddTriangle(top_left, bottom_left, top_right);
      AddTriangle(top_right, bottom_left, bottom_right);
    }
  }

  Mesh mesh;

 private:
  [[nodiscard]] int32_t Vertex(const Quad& q) const { return vertex_(q[0], q[1]); }
  [[nodiscard]] bool Linked(const Quad& a, const Quad& b) const { return links_.Linked(a[0], a[1], b[0], b[1]); }
  [[nodiscard]] bool IsFolded(const std::array<int32_t, 3>& triangle) const {
    const Eigen::Vector3f faces = TriangleNormal(mesh, triangle);
    return std::ranges::any_of(triangle, [&](int32_t v) {
      return Eigen::Map<const Eigen::Vector3f>(mesh.normals[v].data()).dot(faces) < 0.0F;
    });
  }
  void AddTriangle(const Quad& a, const Quad& b, const Quad& c) {
    if (Vertex(a) < 0 || Vertex(b) < 0 || Vertex(c) < 0) return;
    const std::array<int32_t, 3> triangle = {Vertex(a), Vertex(b), Vertex(c)};
    if (Linked(a, b) && Linked(b, c) && Linked(c, a) && !IsFolded(triangle)) mesh.triangles.push_back(triangle);
  }

  const SurfaceMap& surface_;
  const SurfaceLinks links_;
  Image<int32_t> vertex_;
};

}  // namespace

Eigen::Vector3f TriangleNormal(const Mesh& mesh, const std::array<int32_t, 3>& triangle) {
  const auto at = [&](int k) { return Eigen::Map<const Eigen::Vector3f>(mesh.positions_mm[triangle[k]].data()); };
  return (at(1) - at(0)).cross(at(2) - at(0));
}

Mesh MeshFromSurface(const SurfaceMap& surface) {
  MeshBuilder builder(surface);
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      if (surface.mask(i, j) != 0) builder.AddVertex(i, j);
  for (int j = 0; j + 1 < surface.height(); ++j)
    for (int i = 0; i + 1 < surface.width(); ++i) builder.AddCell(i, j);
  return std::move(builder.mesh);
}

}  // namespace stratalux::fit
