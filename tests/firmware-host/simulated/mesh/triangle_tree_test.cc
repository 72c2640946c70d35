// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/mesh/triangle_tree.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "tests/firmware-host/simulated/mesh/small_meshes.h"

namespace stratalux::rig {
namespace {

using Eigen::Vector3d;

Vector3d Somewhere(Random& random, double half) {
  return {random.Uniform(-half, half), random.Uniform(-half, half), random.Uniform(-half, half)};
}

std::vector<std::array<int, 3>> Indices(const MeshData& mesh) {
  std::vector<std::array<int, 3>> indices;
  for (const auto& t : mesh.triangles) indices.push_back(t.vertex);
  return indices;
}

// Triangles of many sizes, anywhere, some of them slivers, points or twice there.
MeshData Heap(uint64_t seed, int count) {
  Random random(seed);
  MeshData mesh;
  for (int i = 0; i < count; ++i) {
    const Vector3d at = Somewhere(random, 100);
    const double size = std::pow(10.0, random.Uniform(-2, 1.8));
    for (int k = 0; k < 3; ++k) mesh.vertices.push_back(at + Somewhere(random, size));
    if (i % 17 == 0) mesh.vertices.back() = mesh.vertices[mesh.vertices.size() - 2];
    mesh.triangles.push_back({{3 * i, 3 * i + 1, 3 * i + 2}});
    if (i % 23 == 0 && i > 0) mesh.triangles.push_back(mesh.triangles[static_cast<size_t>(i) / 2]);
  }
  return mesh;
}

// Cramer's rule for origin + t d = a + u (b - a) + v (c - a), another way to the same point.
struct Crossing {
  double t, margin;  // margin: the least of the three weights
};
std::optional<Crossing> Cross(const Ray3& ray, const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  const Vector3d e1 = b - a, e2 = c - a, s = ray.origin_mm - a;
  const double det = -ray.direction.dot(e1.cross(e2));
  if (std::abs(det) < 1e-12) return std::nullopt;
  const double t = e1.cross(e2).dot(s) / det, u = -ray.direction.dot(s.cross(e2)) / det,
               v = -ray.direction.dot(e1.cross(s)) / det;
  return Crossing{t, std::min({u, v, 1.0 - u - v})};
}

TEST(TriangleTree, MeetsWhatALookAtEveryTriangleMeets) {
  for (const uint64_t seed : {1, 2, 3}) {
    const MeshData heap = Heap(seed, 700);
    const TriangleTree tree(heap.vertices, Indices(heap));
    Random random(seed, 9);
    int hits = 0, doubtful = 0;
    for (int k = 0; k < 3000; ++k) {
      const Vector3d origin = Somewhere(random, 200), to = Somewhere(random, 100);
      const Ray3 ray{origin, (to - origin).normalized()};
      double nearest = 1e300;
      bool doubt = false;
      for (const auto& t : heap.triangles) {
        const auto c = Cross(ray, heap.vertices[t.vertex[0]], heap.vertices[t.vertex[1]], heap.vertices[t.vertex[2]]);
        if (!c || c->t < 0.0) continue;
        doubt = doubt || (std::abs(c->margin) < 1e-9 && c->t < nearest);
        if (c->margin >= 0.0) nearest = std::min(nearest, c->t);
      }
      doubtful += doubt;
      if (doubt) continue;
      const auto hit = tree.FirstHit(ray, 1e300);
      ASSERT_EQ(hit.has_value(), nearest < 1e300) << seed << ", ray " << k;
      if (!hit) continue;
      ++hits;
      ASSERT_NEAR(hit->distance, nearest, 1e-7);
      const auto& corners = heap.triangles[hit->at.triangle].vertex;
      Vector3d there = Vector3d::Zero();
      for (int i = 0; i < 3; ++i) there += hit->at.weights[i] * heap.vertices[corners[i]];
      ASSERT_LT((there - origin - hit->distance * ray.direction).norm(), 1e-7);
      // No hit lies beyond what is asked for.
      ASSERT_FALSE(tree.FirstHit(ray, 0.999 * hit->distance).has_value());
      ASSERT_TRUE(tree.FirstHit(ray, hit->distance).has_value());
    }
    EXPECT_GT(hits, 500);
    EXPECT_LT(doubtful, 30);
  }
}

double DistanceToSegment(const Vector3d& p, const Vector3d& a, const Vector3d& b) {
  const double square = (b - a).squaredNorm();
  const double t = square > 0.0 ? std::clamp((p - a).dot(b - a) / square, 0.0, 1.0) : 0.0;
  return (p - a - t * (b - a)).norm();
}

double DistanceToTriangle(const Vector3d& p, const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  double least = std::min({DistanceToSegment(p, a, b), DistanceToSegment(p, b, c), DistanceToSegment(p, c, a)});
  const Vector3d n = (b - a).cross(c - a);
  if (n.norm() < 1e-14) return least;
  const bool inside =
      n.dot((b - a).cross(p - a)) >= 0 && n.dot((c - b).cross(p - b)) >= 0 && n.dot((a - c).cross(p - c)) >= 0;
  return inside ? std::abs(n.normalized().dot(p - a)) : least;
}

TEST(TriangleTree, NearestPointIsThatOfALookAtEveryTriangle) {
  for (const uint64_t seed : {4, 5}) {
    const MeshData heap = Heap(seed, 600);
    const TriangleTree tree(heap.vertices, Indices(heap));
    Random random(seed, 9);
    for (int k = 0; k < 1500; ++k) {
      const Vector3d p = Somewhere(random, 130);
      double least = 1e300;
      for (const auto& t : heap.triangles)
        least = std::min(least, DistanceToTriangle(p, heap.vertices[t.vertex[0]], heap.vertices[t.vertex[1]],
                                                   heap.vertices[t.vertex[2]]));
      const auto nearest = tree.NearestTo(p);
      ASSERT_NEAR(nearest.distance, least, 1e-9) << seed << ", point " << k;
      ASSERT_NEAR(nearest.at.weights.sum(), 1.0, 1e-12);
      ASSERT_GE(nearest.at.weights.minCoeff(), -1e-12);
    }
  }
}

// A closed surface lets no ray out, wherever its triangles meet.
TEST(TriangleTree, NoRaySlipsThroughEdgesAndCorners) {
  MeshData ball = SphereMesh(80.0, 4);
  Random random(6);
  for (Vector3d& v : ball.vertices) v *= random.Uniform(0.97, 1.03);
  const TriangleTree tree(ball.vertices, Indices(ball));
  for (int round = 0; round < 8; ++round) {
    const Vector3d inside = round == 0 ? Vector3d::Zero() : Somewhere(random, 40);
    for (const Vector3d& v : ball.vertices)
      ASSERT_TRUE(tree.FirstHit({inside, (v - inside).normalized()}, 1e300)) << "through a corner";
    for (const auto& t : ball.triangles)
      for (size_t k = 0; k < 3; ++k) {
        const Vector3d &a = ball.vertices[t.vertex[k]], &b = ball.vertices[t.vertex[(k + 1) % 3]];
        const Vector3d on_edge = a + random.Uniform() * (b - a);
        ASSERT_TRUE(tree.FirstHit({inside, (on_edge - inside).normalized()}, 1e300)) << "through an edge";
      }
  }
}

// A net of squares in the plane z = 0 and rays straight down through its every corner and edge: all sums are exact, and
// each ray meets zeros.
TEST(TriangleTree, RaysAlongAnAxisMeetEveryCornerOfANet) {
  constexpr int kSide = 20;
  MeshData net;
  for (int j = 0; j <= kSide; ++j)
    for (int i = 0; i <= kSide; ++i) net.vertices.emplace_back(i, j, 0.0);
  for (int j = 0; j < kSide; ++j)
    for (int i = 0; i < kSide; ++i) {
      const int at = j * (kSide + 1) + i;
      net.triangles.push_back({{at, at + 1, at + kSide + 2}});
      net.triangles.push_back({{at, at + kSide + 2, at + kSide + 1}});
    }
  for (int axis = 0; axis < 3; ++axis) {
    MeshData turned = net;
    for (Vector3d& v : turned.vertices) v = Vector3d(v[(3 - axis) % 3], v[(4 - axis) % 3], v[(5 - axis) % 3]);
    const TriangleTree tree(turned.vertices, Indices(turned));
    for (const double sign : {-1.0, 1.0})
      for (double y = 0.0; y <= kSide; y += 0.5)
        for (double x = 0.0; x <= kSide; x += 0.5) {
          const Vector3d at(x, y, -5.0 * sign), along(0.0, 0.0, sign);
          const Ray3 ray{{at[(3 - axis) % 3], at[(4 - axis) % 3], at[(5 - axis) % 3]},
                         {along[(3 - axis) % 3], along[(4 - axis) % 3], along[(5 - axis) % 3]}};
          const auto hit = tree.FirstHit(ray, 1e300);
          ASSERT_TRUE(hit.has_value()) << x << ", " << y << " along axis " << axis;
          ASSERT_EQ(hit->distance, 5.0);
        }
  }
}

// A thousand triangles in one place, and a row whose gaps double: both drive a tree to its limits.
TEST(TriangleTree, DegenerateHeapsAreBuiltAndMet) {
  MeshData same, row;
  for (int i = 0; i < 5000; ++i) {
    same.triangles.push_back({{0, 1, 2}});
    const double at = i < 1000 ? std::ldexp(1.0, i - 700) : 1.0;
    for (const Vector3d& v : {Vector3d(at, 0, 0), Vector3d(at, 1, 0), Vector3d(at, 0, 1)}) row.vertices.push_back(v);
    row.triangles.push_back({{3 * i, 3 * i + 1, 3 * i + 2}});
  }
  same.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  const TriangleTree heap(same.vertices, Indices(same)), line(row.vertices, Indices(row));
  const auto hit = heap.FirstHit({{0.2, 0.2, -1}, {0, 0, 1}}, 10.0);
  ASSERT_TRUE(hit.has_value());
  EXPECT_EQ(hit->at.triangle, 0) << "of equal ones the first";
  EXPECT_EQ(heap.NearestTo({0.2, 0.2, -1}).at.triangle, 0);
  const auto last = line.FirstHit({{0.75, 0.2, 0.2}, {1, 0, 0}}, 1e300);
  ASSERT_TRUE(last.has_value());
  EXPECT_NEAR(last->distance, 0.25, 1e-15);
}

}  // namespace
}  // namespace stratalux::rig
