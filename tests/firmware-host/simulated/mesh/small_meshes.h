// SPDX-License-Identifier: Apache-2.0
// Small meshes that tests make themselves.
#pragma once

#include <cmath>
#include <cstdio>
#include <map>
#include <string>
#include <utility>

#include "firmware-host/simulated/mesh/mesh_file.h"

namespace stratalux::rig {

// Each edge of an icosahedron halved `halvings` times, all vertices on a sphere about the origin; faces wound
// counter-clockwise from outside.
inline MeshData SphereMesh(double radius, int halvings) {
  MeshData mesh;
  const double g = (1.0 + std::sqrt(5.0)) / 2.0;
  for (const double a : {-1.0, 1.0})
    for (const double b : {-g, g})
      for (int k = 0; k < 3; ++k) {
        Eigen::Vector3d v;
        v[k] = 0.0;
        v[(k + 1) % 3] = a;
        v[(k + 2) % 3] = b;
        mesh.vertices.push_back(radius * v.normalized());
      }
  const double edge = 2.0 * radius / std::sqrt(1.0 + g * g) * 1.01;
  const int count = static_cast<int>(mesh.vertices.size());
  for (int i = 0; i < count; ++i)
    for (int j = i + 1; j < count; ++j)
      for (int k = j + 1; k < count; ++k) {
        const auto &a = mesh.vertices[i], &b = mesh.vertices[j], &c = mesh.vertices[k];
        if ((a - b).norm() > edge || (b - c).norm() > edge || (c - a).norm() > edge) continue;
        const bool outward = (b - a).cross(c - a).dot(a) > 0.0;
        mesh.triangles.push_back({outward ? std::array<int, 3>{i, j, k} : std::array<int, 3>{i, k, j}});
      }
  for (int round = 0; round < halvings; ++round) {
    std::map<std::pair<int, int>, int> middles;
    auto middle = [&](int a, int b) {
      const auto [found, fresh] = middles.emplace(std::minmax(a, b), static_cast<int>(mesh.vertices.size()));
      if (fresh) mesh.vertices.push_back(radius * (mesh.vertices[a] + mesh.vertices[b]).normalized());
      return found->second;
    };
    std::vector<MeshData::Triangle> fine;
    for (const auto& t : mesh.triangles) {
      const auto [a, b, c] = t.vertex;
      const int ab = middle(a, b), bc = middle(b, c), ca = middle(c, a);
      for (const auto& v : {std::array<int, 3>{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}}) fine.push_back({v});
    }
    mesh.triangles = std::move(fine);
  }
  return mesh;
}

// From -half to half, each face two triangles, wound counter-clockwise from outside.
inline MeshData CubeMesh(double half) {
  MeshData mesh;
  for (int i = 0; i < 8; ++i)
    mesh.vertices.push_back(half * Eigen::Vector3d(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1));
  constexpr int kFaces[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  for (const auto& f : kFaces) {
    mesh.triangles.push_back({{f[0], f[1], f[2]}});
    mesh.triangles.push_back({{f[0], f[2], f[3]}});
  }
  return mesh;
}

inline std::string ObjOf(const MeshData& mesh) {
  std::string text;
  char line[160];
  for (const Eigen::Vector3d& v : mesh.vertices) {
    std::snprintf(line, sizeof line, "v %.17g %.17g %.17g\n", v.x(), v.y(), v.z());
    text += line;
  }
  for (const Eigen::Vector2d& t : mesh.texture) {
    std::snprintf(line, sizeof line, "vt %.17g %.17g\n", t.x(), t.y());
    text += line;
  }
  for (const auto& t : mesh.triangles) {
    text += "f";
    for (size_t k = 0; k < 3; ++k) {
      text += " " + std::to_string(t.vertex[k] + 1);
      if (t.texture[k] != MeshData::kNone) text += "/" + std::to_string(t.texture[k] + 1);
    }
    text += "\n";
  }
  return text;
}

}  // namespace stratalux::rig
