// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/mesh/triangle_tree.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "shared/base/check.h"

namespace stratalux::rig {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr int kLeafTriangles = 4;
constexpr int kBins = 16;
// Beyond it the tree is halved by numbers, whatever the triangles' places: at most 22 levels more for 4 million.
constexpr int kMostUnevenLevels = 48;
constexpr int kMostLevels = 96;

double AreaOf(const Eigen::AlignedBox3d& box) {
  if (box.isEmpty()) return 0.0;
  const Eigen::Vector3d s = box.sizes();
  return s.x() * s.y() + s.y() * s.z() + s.z() * s.x();
}

// A ray as Woop et al. shear it: its largest axis becomes z, the others are sheared so that it runs along z, and a
// triangle is met where the origin of the plane lies within it. Every triangle's corner goes through the same numbers;
// an edge's function is the difference of two rounded products, whose sign is right or which is 0, and 0 counts as
// within. That holds as long as no product is fused with its difference: this file is compiled with -ffp-contract=off.
class ShearedRay {
 public:
  // `all`: a box around every triangle.
  ShearedRay(const Ray3& ray, const Eigen::AlignedBox3d& all) : origin_(ray.origin_mm) {
    ray.direction.cwiseAbs().maxCoeff(&kz_);
    kx_ = (kz_ + 1) % 3;
    ky_ = (kx_ + 1) % 3;
    shear_x_ = ray.direction[kx_] / ray.direction[kz_];
    shear_y_ = ray.direction[ky_] / ray.direction[kz_];
    shear_z_ = 1.0 / ray.direction[kz_];
    inverse_ = ray.direction.cwiseInverse();
    const double farthest = all.min().cwiseAbs().cwiseMax(all.max().cwiseAbs()).maxCoeff();
    rounding_ = 32.0 * std::numeric_limits<double>::epsilon() * (origin_.cwiseAbs().maxCoeff() + farthest);
  }

  // Distance and weights; nullopt where the ray passes by.
  struct Met {
    double distance;
    Eigen::Vector3d weights;
  };
  [[nodiscard]] std::optional<Met> Meet(const std::array<Eigen::Vector3d, 3>& corners) const {
    std::array<Eigen::Vector3d, 3> p;
    for (size_t k = 0; k < 3; ++k) {
      const Eigen::Vector3d d = corners[k] - origin_;
      p[k] = {d[kx_] - shear_x_ * d[kz_], d[ky_] - shear_y_ * d[kz_], d[kz_]};
    }
    const double u = p[2].x() * p[1].y() - p[2].y() * p[1].x();
    const double v = p[0].x() * p[2].y() - p[0].y() * p[2].x();
    const double w = p[1].x() * p[0].y() - p[1].y() * p[0].x();
    if ((u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0)) return std::nullopt;
    const double sum = u + v + w;
    if (sum == 0.0) return std::nullopt;  // seen from its edge: its neighbours are met
    const Eigen::Vector3d weights = Eigen::Vector3d(u, v, w) / sum;
    return Met{shear_z_ * (weights.x() * p[0].z() + weights.y() * p[1].z() + weights.z() * p[2].z()), weights};
  }

  // Where the ray enters the box, before `farthest`; infinity where it does not. The box is larger than itself by more
  // than what rounding moves the sheared ray sideways, so that no triangle that Meet() would meet is lost.
  [[nodiscard]] double Enter(const Eigen::AlignedBox3d& box, double farthest) const {
    double near = 0.0, far = farthest;
    for (int k = 0; k < 3; ++k) {
      double t0 = (box.min()[k] - rounding_ - origin_[k]) * inverse_[k],
             t1 = (box.max()[k] + rounding_ - origin_[k]) * inverse_[k];
      if (inverse_[k] < 0.0) std::swap(t0, t1);
      // Within a face of the box and along it, 0 times infinity bounds nothing.
      if (t0 > near) near = t0;
      if (t1 < far) far = t1;
    }
    return near <= far ? near : kInfinity;
  }

 private:
  Eigen::Vector3d origin_, inverse_;
  int kx_ = 0, ky_ = 1, kz_ = 2;
  double shear_x_ = 0.0, shear_y_ = 0.0, shear_z_ = 1.0;
  double rounding_ = 0.0;
};

// Ericson, "Real-Time Collision Detection" (2005), 5.1.5.
Eigen::Vector3d NearestWeights(const std::array<Eigen::Vector3d, 3>& c, const Eigen::Vector3d& p) {
  const Eigen::Vector3d ab = c[1] - c[0], ac = c[2] - c[0], ap = p - c[0];
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0.0 && d2 <= 0.0) return {1, 0, 0};
  const Eigen::Vector3d bp = p - c[1];
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0.0 && d4 <= d3) return {0, 1, 0};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0) {
    const double v = d1 - d3 > 0.0 ? d1 / (d1 - d3) : 0.0;
    return {1.0 - v, v, 0.0};
  }
  const Eigen::Vector3d cp = p - c[2];
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0.0 && d5 <= d6) return {0, 0, 1};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0) {
    const double w = d2 - d6 > 0.0 ? d2 / (d2 - d6) : 0.0;
    return {1.0 - w, 0.0, w};
  }
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0) {
    const double side = (d4 - d3) + (d5 - d6), w = side > 0.0 ? (d4 - d3) / side : 0.0;
    return {0.0, 1.0 - w, w};
  }
  const double sum = va + vb + vc;
  return Eigen::Vector3d(va, vb, vc) / sum;
}

}  // namespace

// Top down by the surface area heuristic over kBins bins of the widest axis of the centres.
class TriangleTree::Builder {
 public:
  Builder(const std::vector<Eigen::Vector3d>& vertices, const std::vector<std::array<int, 3>>& triangles,
          std::vector<Node>& nodes)
      : boxes_(triangles.size()), order_(triangles.size()), nodes_(nodes) {
    for (size_t i = 0; i < triangles.size(); ++i)
      for (const int corner : triangles[i]) boxes_[i].extend(vertices[corner]);
    std::iota(order_.begin(), order_.end(), 0);
    Build(0, static_cast<int>(order_.size()), 0);
  }
  [[nodiscard]] const std::vector<int>& order() const { return order_; }

 private:
  void Build(int begin, int end, int level) {
    const size_t at = nodes_.size();
    nodes_.emplace_back();
    Eigen::AlignedBox3d box, centres;
    for (int i = begin; i < end; ++i) {
      box.extend(boxes_[order_[i]]);
      centres.extend(boxes_[order_[i]].center());
    }
    nodes_[at].box = box;
    if (end - begin <= kLeafTriangles) {
      nodes_[at].first = begin;
      nodes_[at].count = end - begin;
      return;
    }
    const int middle = level < kMostUnevenLevels ? Split(begin, end, centres) : (begin + end) / 2;
    Build(begin, middle, level + 1);
    nodes_[at].first = static_cast<int>(nodes_.size());
    Build(middle, end, level + 1);
  }

  int Split(int begin, int end, const Eigen::AlignedBox3d& centres) {
    int axis = 0;
    const double width = centres.sizes().maxCoeff(&axis);
    if (!(width > 0.0)) return (begin + end) / 2;
    auto bin_of = [&](int triangle) {
      const double share = (boxes_[triangle].center()[axis] - centres.min()[axis]) / width;
      return std::clamp(static_cast<int>(share * kBins), 0, kBins - 1);
    };
    std::array<Eigen::AlignedBox3d, kBins> boxes;
    std::array<int, kBins> counts{};
    for (int i = begin; i < end; ++i) {
      const int bin = bin_of(order_[i]);
      boxes[bin].extend(boxes_[order_[i]]);
      ++counts[bin];
    }
    std::array<double, kBins> right{};
    Eigen::AlignedBox3d box;
    for (int bin = kBins - 1, count = 0; bin > 0; --bin) {
      box.extend(boxes[bin]);
      right[bin] = AreaOf(box) * (count += counts[bin]);
    }
    box.setEmpty();
    double least = kInfinity;
    int best = 0;
    for (int bin = 0, count = 0; bin + 1 < kBins; ++bin) {
      box.extend(boxes[bin]);
      count += counts[bin];
      if (count == 0 || count == end - begin) continue;
      if (const double cost = AreaOf(box) * count + right[bin + 1]; cost < least) {
        least = cost;
        best = bin;
      }
    }
    const auto middle = std::stable_partition(order_.begin() + begin, order_.begin() + end,
                                              [&](int triangle) { return bin_of(triangle) <= best; });
    const int at = static_cast<int>(middle - order_.begin());
    return at == begin || at == end ? (begin + end) / 2 : at;
  }

  std::vector<Eigen::AlignedBox3d> boxes_;
  std::vector<int> order_;
  std::vector<Node>& nodes_;
};

TriangleTree::TriangleTree(const std::vector<Eigen::Vector3d>& vertices,
                           const std::vector<std::array<int, 3>>& triangles) {
  SLX_CHECK(!triangles.empty());
  const Builder builder(vertices, triangles, nodes_);
  entries_.reserve(triangles.size());
  for (const int i : builder.order()) {
    const std::array<int, 3>& t = triangles[i];
    entries_.push_back({{vertices[t[0]], vertices[t[1]], vertices[t[2]]}, i});
  }
}

std::optional<TriangleTree::Hit> TriangleTree::FirstHit(const Ray3& ray, double farthest) const {
  const ShearedRay sheared(ray, nodes_[0].box);
  std::optional<Hit> first;
  std::array<int, kMostLevels> waiting;
  int count = 0;
  int at = sheared.Enter(nodes_[0].box, farthest) < kInfinity ? 0 : -1;
  while (at >= 0) {
    const Node& node = nodes_[at];
    at = -1;
    for (int i = node.first; i < node.first + node.count; ++i) {
      const auto met = sheared.Meet(entries_[i].corners);
      if (!met || !(met->distance > 0.0) || met->distance > farthest) continue;
      if (first && met->distance == farthest && entries_[i].triangle > first->at.triangle) continue;
      farthest = met->distance;
      first = Hit{met->distance, {entries_[i].triangle, met->weights}};
    }
    if (node.count == 0) {
      int near = static_cast<int>(&node - nodes_.data()) + 1, far = node.first;
      double near_at = sheared.Enter(nodes_[near].box, farthest), far_at = sheared.Enter(nodes_[far].box, farthest);
      if (far_at < near_at) {
        std::swap(near, far);
        std::swap(near_at, far_at);
      }
      if (far_at < kInfinity) waiting[count++] = far;
      if (near_at < kInfinity) at = near;
    }
    while (at < 0 && count > 0) {
      const int next = waiting[--count];
      if (sheared.Enter(nodes_[next].box, farthest) < kInfinity) at = next;
    }
  }
  return first;
}

TriangleTree::Nearest TriangleTree::NearestTo(const Eigen::Vector3d& point) const {
  double least = kInfinity;  // squared
  TrianglePoint best;
  std::array<int, kMostLevels> waiting;
  int count = 0;
  waiting[count++] = 0;
  while (count > 0) {
    const int at = waiting[--count];
    const Node& node = nodes_[at];
    if (node.box.squaredExteriorDistance(point) > least) continue;
    for (int i = node.first; i < node.first + node.count; ++i) {
      const Entry& e = entries_[i];
      const Eigen::Vector3d weights = NearestWeights(e.corners, point);
      const Eigen::Vector3d there =
          weights.x() * e.corners[0] + weights.y() * e.corners[1] + weights.z() * e.corners[2];
      const double squared = (point - there).squaredNorm();
      if (squared > least || (squared == least && e.triangle > best.triangle)) continue;
      least = squared;
      best = {e.triangle, weights};
    }
    if (node.count > 0) continue;
    const int a = at + 1, b = node.first;
    const bool a_first = nodes_[a].box.squaredExteriorDistance(point) <= nodes_[b].box.squaredExteriorDistance(point);
    waiting[count++] = a_first ? b : a;
    waiting[count++] = a_first ? a : b;
  }
  return {std::sqrt(least), best};
}

}  // namespace stratalux::rig
