// SPDX-License-Identifier: Apache-2.0
// Triangles in a tree of boxes: the first that a ray meets, and the one nearest to a point. Lengths in the vertices'
// unit. Immutable, hence safe from any thread; results do not depend on how the tree is built.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "shared/geometry/rigid3.h"

namespace stratalux::rig {

// A point of a triangle: the sum of its corners, weighted.
struct TrianglePoint {
  int triangle = 0;
  Eigen::Vector3d weights = Eigen::Vector3d::Zero();  // add up to 1
};

class TriangleTree {
 public:
  struct Hit {
    double distance = 0.0;  // along the ray
    TrianglePoint at;
  };
  struct Nearest {
    double distance = 0.0;
    TrianglePoint at;
  };

  // `triangles`: indices of `vertices`. Precondition: at least one, all within range, all vertices finite.
  TriangleTree(const std::vector<Eigen::Vector3d>& vertices, const std::vector<std::array<int, 3>>& triangles);

  // The hit nearest to the origin within (0, farthest]; either side counts. Watertight (Woop, Benthin and Wald,
  // "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013): a ray to any point of a shared edge or corner meets one
  // of those triangles that share it.
  [[nodiscard]] std::optional<Hit> FirstHit(const Ray3& ray, double farthest) const;
  // The point of all triangles nearest to `point`; of equally near ones that of the first triangle.
  [[nodiscard]] Nearest NearestTo(const Eigen::Vector3d& point) const;
  [[nodiscard]] Eigen::AlignedBox3d box() const { return nodes_.front().box; }

 private:
  struct Node {
    Eigen::AlignedBox3d box;
    int first = 0;  // of a leaf, its first entry; else its second child (the first one follows it)
    int count = 0;  // entries of a leaf; 0: no leaf
  };
  struct Entry {
    std::array<Eigen::Vector3d, 3> corners;
    int triangle = 0;
  };
  class Builder;

  std::vector<Node> nodes_;
  std::vector<Entry> entries_;  // leaf by leaf
};

}  // namespace stratalux::rig
