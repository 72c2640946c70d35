// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/mesh/surface.h"

#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <utility>

#include "shared/base/check.h"
#include "shared/units/angle.h"

namespace stratalux::rig {
namespace {

using Eigen::Vector3d;

// Triangles around one vertex, each held against all: more than any crease has.
constexpr int kMostAtCrease = 256;

// Of length 0 where the triangle has no area.
Vector3d FaceNormal(const MeshData& mesh, const MeshData::Triangle& t) {
  const auto& v = mesh.vertices;
  return (v[t.vertex[1]] - v[t.vertex[0]]).cross(v[t.vertex[2]] - v[t.vertex[0]]).normalized();
}

double AngleAt(const MeshData& mesh, const MeshData::Triangle& t, size_t corner) {
  const Vector3d& at = mesh.vertices[t.vertex[corner]];
  const Vector3d a = mesh.vertices[t.vertex[(corner + 1) % 3]] - at, b = mesh.vertices[t.vertex[(corner + 2) % 3]] - at;
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

// Corners around each vertex: those of vertex v are corners[first[v]] .. corners[first[v + 1]].
struct Around {
  std::vector<int> first;
  std::vector<std::pair<int, int>> corners;  // triangle, corner
};
Around CornersAround(const MeshData& mesh) {
  Around around;
  around.first.assign(mesh.vertices.size() + 1, 0);
  for (const auto& t : mesh.triangles)
    for (const int v : t.vertex) ++around.first[v + 1];
  for (size_t v = 0; v + 1 < around.first.size(); ++v) around.first[v + 1] += around.first[v];
  around.corners.resize(3 * mesh.triangles.size());
  std::vector<int> next(around.first.begin(), around.first.end() - 1);
  for (size_t t = 0; t < mesh.triangles.size(); ++t)
    for (int k = 0; k < 3; ++k) around.corners[next[mesh.triangles[t].vertex[k]]++] = {static_cast<int>(t), k};
  return around;
}

// A cubic patch over one triangle: b[i][j] with k = 3 - i - j, the point of weights i, j, k of corners 0, 1, 2.
class Patch {
 public:
  Patch(const std::array<Vector3d, 3>& p, const std::array<Vector3d, 3>& n) : corners_(p) {
    Vector3d edges = Vector3d::Zero();
    for (size_t from = 0; from < 3; ++from)
      for (size_t to = 0; to < 3; ++to) {
        if (from == to) continue;
        // A third of the way, put into the plane across the normal of the nearer corner.
        edge_[from][to] = (2.0 * p[from] + p[to] - (p[to] - p[from]).dot(n[from]) * n[from]) / 3.0;
        edges += edge_[from][to] / 6.0;
      }
    middle_ = edges + (edges - (p[0] + p[1] + p[2]) / 3.0) / 2.0;
  }

  [[nodiscard]] Vector3d At(const Vector3d& w) const {
    Vector3d point = 6.0 * w[0] * w[1] * w[2] * middle_;
    for (int a = 0; a < 3; ++a) {
      point += w[a] * w[a] * w[a] * corners_[a];
      for (int b = 0; b < 3; ++b)
        if (a != b) point += 3.0 * w[a] * w[a] * w[b] * edge_[a][b];
    }
    return point;
  }

 private:
  std::array<Vector3d, 3> corners_;
  std::array<std::array<Vector3d, 3>, 3> edge_;
  Vector3d middle_;
};

// Cuts triangles into `steps` * `steps`, with one vertex for each place of an edge.
class Subdivider {
 public:
  Subdivider(const MeshData& mesh, int steps)
      : mesh_(mesh), normals_(AngleWeightedNormals(mesh, 180.0)), steps_(steps) {
    fine_.vertices = mesh.vertices;
    fine_.texture = mesh.texture;
    for (size_t t = 0; t < mesh.triangles.size(); ++t) Cut(t);
  }
  [[nodiscard]] MeshData Take() && { return std::move(fine_); }

 private:
  void Cut(size_t index) {
    const MeshData::Triangle& t = mesh_.triangles[index];
    std::array<Vector3d, 3> corners;
    for (size_t k = 0; k < 3; ++k) corners[k] = mesh_.vertices[t.vertex[k]];
    const Patch patch(corners, normals_[index]);
    const bool textured = t.texture[0] != MeshData::kNone;
    std::vector<int> vertex, texture;  // of row j, column i: weights (steps - i - j, i, j) / steps
    for (int j = 0; j <= steps_; ++j)
      for (int i = 0; i + j <= steps_; ++i) {
        const std::array<int, 3> at = {steps_ - i - j, i, j};
        vertex.push_back(VertexAt(t, patch, at));
        texture.push_back(textured ? TextureAt(t, at) : MeshData::kNone);
      }
    auto node = [&](int i, int j) { return static_cast<size_t>(j * (steps_ + 1) - j * (j - 1) / 2 + i); };
    auto add = [&](size_t a, size_t b, size_t c) {
      fine_.triangles.push_back({{vertex[a], vertex[b], vertex[c]}, {texture[a], texture[b], texture[c]}});
    };
    for (int j = 0; j < steps_; ++j)
      for (int i = 0; i + j < steps_; ++i) {
        add(node(i, j), node(i + 1, j), node(i, j + 1));
        if (i + j + 1 < steps_) add(node(i + 1, j), node(i + 1, j + 1), node(i, j + 1));
      }
  }

  int VertexAt(const MeshData::Triangle& t, const Patch& patch, const std::array<int, 3>& at) {
    const Vector3d weights = Vector3d(at[0], at[1], at[2]) / steps_;
    for (size_t k = 0; k < 3; ++k) {
      if (at[k] == steps_) return t.vertex[k];
      if (at[k] != 0) continue;
      // On the edge across corner k: the neighbour comes to it from the other side.
      const size_t a = (k + 1) % 3, b = (k + 2) % 3;
      if (at[a] == steps_ || at[b] == steps_) continue;
      const bool rising = t.vertex[a] < t.vertex[b];
      const std::array<int, 3> key = {std::min(t.vertex[a], t.vertex[b]), std::max(t.vertex[a], t.vertex[b]),
                                      rising ? at[a] : at[b]};
      const auto [found, fresh] = on_edge_.emplace(key, static_cast<int>(fine_.vertices.size()));
      if (fresh) fine_.vertices.push_back(patch.At(weights));
      return found->second;
    }
    fine_.vertices.push_back(patch.At(weights));
    return static_cast<int>(fine_.vertices.size()) - 1;
  }

  int TextureAt(const MeshData::Triangle& t, const std::array<int, 3>& at) {
    Eigen::Vector2d sum(0, 0);
    for (size_t k = 0; k < 3; ++k) {
      if (at[k] == steps_) return t.texture[k];
      sum += static_cast<double>(at[k]) / steps_ * mesh_.texture[t.texture[k]];
    }
    fine_.texture.push_back(sum);
    return static_cast<int>(fine_.texture.size()) - 1;
  }

  const MeshData& mesh_;
  CornerNormals normals_;
  int steps_;
  MeshData fine_;
  std::map<std::array<int, 3>, int> on_edge_;
};

}  // namespace

CornerNormals AngleWeightedNormals(const MeshData& mesh, double crease_deg) {
  const double least_cosine = std::cos(RadFromDeg(crease_deg)) - 1e-12;
  std::vector<Vector3d> faces;
  for (const auto& t : mesh.triangles) faces.push_back(FaceNormal(mesh, t));
  const Around around = CornersAround(mesh);
  // `face`: with which the others are held to the crease; null: with none.
  auto mean_at = [&](int v, const Vector3d* face) {
    Vector3d sum = Vector3d::Zero();
    for (int i = around.first[v]; i < around.first[v + 1]; ++i) {
      const auto [other, corner] = around.corners[i];
      if (face != nullptr && face->dot(faces[other]) < least_cosine) continue;
      sum += AngleAt(mesh, mesh.triangles[other], static_cast<size_t>(corner)) * faces[other];
    }
    // Faces that lie on each other, wound both ways, leave nothing.
    return Vector3d(sum.norm() > 1e-9 ? sum.normalized() : Vector3d::Zero());
  };
  std::vector<Vector3d> smooth(mesh.vertices.size());
  for (size_t v = 0; v < smooth.size(); ++v) smooth[v] = mean_at(static_cast<int>(v), nullptr);
  CornerNormals normals(mesh.triangles.size());
  for (size_t t = 0; t < mesh.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k) {
      const int v = mesh.triangles[t].vertex[k];
      const bool creased =
          crease_deg < 180.0 && !faces[t].isZero(0.0) && around.first[v + 1] - around.first[v] <= kMostAtCrease;
      normals[t][k] = creased ? mean_at(v, &faces[t]) : smooth[v];
      if (normals[t][k].isZero(0.0)) normals[t][k] = faces[t];
      if (normals[t][k].isZero(0.0)) normals[t][k] = Vector3d::UnitZ();
    }
  return normals;
}

std::optional<CornerNormals> NormalsOfFile(const MeshData& mesh) {
  CornerNormals normals(mesh.triangles.size());
  for (size_t t = 0; t < mesh.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k) {
      const int index = mesh.triangles[t].normal[k];
      if (index == MeshData::kNone || mesh.normals[index].norm() < 1e-9) return std::nullopt;
      normals[t][k] = mesh.normals[index].normalized();
    }
  return normals;
}

MeshData Subdivide(const MeshData& mesh, int subdivisions) {
  SLX_CHECK(subdivisions >= 0 && subdivisions <= kMostSubdivisions);
  return subdivisions == 0 ? mesh : Subdivider(mesh, 1 << subdivisions).Take();
}

}  // namespace stratalux::rig
