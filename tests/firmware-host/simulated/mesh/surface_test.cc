// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/mesh/surface.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>

#include "firmware-host/simulated/mesh/triangle_tree.h"
#include "shared/base/random.h"
#include "tests/firmware-host/simulated/mesh/small_meshes.h"

namespace stratalux::rig {
namespace {

using Eigen::Vector3d;

TEST(AngleWeightedNormals, AreThoseOfTheSphere) {
  const MeshData ball = SphereMesh(80.0, 3);
  const CornerNormals normals = AngleWeightedNormals(ball, 180.0);
  double farthest = 0.0;
  for (size_t t = 0; t < ball.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k)
      farthest = std::max(farthest, (normals[t][k] - ball.vertices[ball.triangles[t].vertex[k]].normalized()).norm());
  std::printf("farthest from the radius: %.5f rad\n", farthest);
  EXPECT_LT(farthest, 0.01) << "facets are turned by 0.09 rad";
}

TEST(AngleWeightedNormals, DoNotDependOnHowFacesAreCut) {
  // At a cube's corner three squares meet at right angles, however many triangles each of them brings there.
  MeshData cube = CubeMesh(10.0), other = cube;
  for (size_t f = 0; f < other.triangles.size(); f += 2) {
    const auto a = other.triangles[f].vertex, b = other.triangles[f + 1].vertex;  // 0 1 2 and 0 2 3
    other.triangles[f].vertex = {a[0], a[1], b[2]};
    other.triangles[f + 1].vertex = {a[1], a[2], b[2]};
  }
  for (const MeshData& mesh : {cube, other}) {
    const CornerNormals normals = AngleWeightedNormals(mesh, 180.0);
    for (size_t t = 0; t < mesh.triangles.size(); ++t)
      for (size_t k = 0; k < 3; ++k)
        ASSERT_LT((normals[t][k] - mesh.vertices[mesh.triangles[t].vertex[k]].normalized()).norm(), 1e-12);
  }
}

TEST(AngleWeightedNormals, KeepEdgesThatAreSharperThanTheCrease) {
  const MeshData cube = CubeMesh(10.0);
  for (const double crease : {0.0, 30.0, 89.0}) {
    const CornerNormals normals = AngleWeightedNormals(cube, crease);
    for (size_t t = 0; t < cube.triangles.size(); ++t) {
      const auto& v = cube.triangles[t].vertex;
      const Vector3d face =
          (cube.vertices[v[1]] - cube.vertices[v[0]]).cross(cube.vertices[v[2]] - cube.vertices[v[0]]).normalized();
      for (const Vector3d& n : normals[t]) ASSERT_LT((n - face).norm(), 1e-12) << crease;
    }
  }
  EXPECT_LT((AngleWeightedNormals(cube, 91.0)[0][0] - cube.vertices[0].normalized()).norm(), 1e-12);
}

TEST(NormalsOfFile, AreTakenWhereEveryCornerHasOne) {
  MeshData mesh;
  mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  mesh.normals = {{0, 0, 2}, {0, 3, 0}, {0, 0, 0}};
  mesh.triangles = {{{0, 1, 2}}};
  EXPECT_FALSE(NormalsOfFile(mesh).has_value());
  mesh.triangles[0].normal = {0, 1, 0};
  ASSERT_TRUE(NormalsOfFile(mesh).has_value());
  EXPECT_EQ((*NormalsOfFile(mesh))[0][1], Vector3d(0, 1, 0));
  mesh.triangles[0].normal = {0, 1, 2};
  EXPECT_FALSE(NormalsOfFile(mesh).has_value()) << "of no length";
}

TEST(Subdivide, AnIcosahedronNearsItsSphereAndStaysClosed) {
  // Over a triangle of edges of angle a facets lie R a^2 / 6 within the sphere; in the middle of a patch
  // cos(a / sqrt(3)) (1 + (1 - cos a) / 3) = 1 - a^4 / 27 + ...
  for (int halvings = 0; halvings < 3; ++halvings) {
    const MeshData coarse = SphereMesh(80.0, halvings);
    double angle = 0.0;  // of the longest edge
    for (const auto& t : coarse.triangles)
      angle = std::max(angle, std::acos(coarse.vertices[t.vertex[0]].dot(coarse.vertices[t.vertex[1]]) / 6400.0));
    const MeshData fine = Subdivide(coarse, 3);
    ASSERT_EQ(fine.triangles.size(), coarse.triangles.size() * 64);
    // Euler: a closed surface has half as many faces as vertices, and 2 more vertices.
    EXPECT_EQ(fine.vertices.size(), fine.triangles.size() / 2 + 2);
    auto deepest = [](const MeshData& mesh) {
      double most = 0.0;
      for (const auto& t : mesh.triangles) {
        const Vector3d middle =
            (mesh.vertices[t.vertex[0]] + mesh.vertices[t.vertex[1]] + mesh.vertices[t.vertex[2]]) / 3;
        most = std::max(most, std::abs(80.0 - middle.norm()));
      }
      return most;
    };
    const double facets = 80.0 * angle * angle / 6.0, patches = 80.0 * std::pow(angle, 4) / 27.0;
    // Beside that, what normals are off where triangles of unlike sizes meet: 0.4 degrees, over half an edge of 26 mm.
    constexpr double kUnlike = 0.4 / 57.29578 * 13.0;
    double farthest = 0.0;
    for (const Vector3d& v : fine.vertices) farthest = std::max(farthest, std::abs(v.norm() - 80.0));
    std::printf("edges of %.1f degrees: facets %.3f mm, vertices on patches %.4f mm off\n", angle * 57.29578,
                deepest(coarse), farthest);
    EXPECT_NEAR(deepest(coarse), facets, 0.15 * facets);
    EXPECT_LT(farthest, 1.1 * patches + kUnlike);
    EXPECT_LT(deepest(fine), 1.1 * patches + 1.1 * facets / 64.0 + kUnlike);
    if (halvings == 0) {
      EXPECT_NEAR(farthest, 80.0 - 80.0 * 0.7946545 * (1.0 + 0.5527864 / 3.0), 0.2)
          << "the closed form of the middle, which an eighth of an edge's halves pass by";
    }
    std::vector<std::array<int, 3>> indices;
    for (const auto& t : fine.triangles) indices.push_back(t.vertex);
    const TriangleTree tree(fine.vertices, indices);
    for (const Vector3d& v : fine.vertices)
      ASSERT_TRUE(tree.FirstHit({{1, 2, 3}, (v - Vector3d(1, 2, 3)).normalized()}, 1e9));
  }
}

TEST(Subdivide, LeavesAPlaneFlatAndItsTextureStraight) {
  MeshData plane;
  plane.vertices = {{0, 0, 5}, {8, 0, 5}, {0, 8, 5}, {8, 8, 5}};
  for (const Vector3d& v : plane.vertices) plane.texture.emplace_back(v.x() / 8, v.y() / 8);
  plane.triangles = {{{0, 1, 2}, {0, 1, 2}}, {{1, 3, 2}, {1, 3, 2}}};
  const MeshData fine = Subdivide(plane, 2);
  ASSERT_EQ(fine.triangles.size(), 32U);
  EXPECT_EQ(fine.vertices.size(), 25U);
  for (const auto& t : fine.triangles) {
    const Vector3d &a = fine.vertices[t.vertex[0]], &b = fine.vertices[t.vertex[1]], &c = fine.vertices[t.vertex[2]];
    EXPECT_NEAR((b - a).cross(c - a).z(), 4.0, 1e-9) << "as large as its neighbours, the same way round";
    for (size_t k = 0; k < 3; ++k) {
      const Vector3d& v = fine.vertices[t.vertex[k]];
      EXPECT_NEAR(v.z(), 5.0, 1e-12);
      EXPECT_LT((8.0 * fine.texture[t.texture[k]] - v.head<2>()).norm(), 1e-9);
    }
  }
}

}  // namespace
}  // namespace stratalux::rig
