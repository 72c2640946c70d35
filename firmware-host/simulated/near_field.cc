// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/near_field.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "shared/base/check.h"

namespace stratalux::rig {
namespace {

constexpr int kFootprintSamples = 4;  // a polar node
constexpr int kSmoothSamples = 8;     // of the rest, a projector pixel
constexpr size_t kMostNodes = 512;

// Points of Roberts' additive recurrence in [-1/2, 1/2]^D, whose every beginning covers the box evenly; `root` solves
// x^(D+1) = x + 1.
template <int D>
std::array<float, D> EvenPoint(int k, double root) {
  std::array<float, D> point{};
  for (int d = 0; d < D; ++d) {
    const double x = 0.5 + (k + 1) * std::pow(root, -(d + 1));
    point[d] = static_cast<float>(x - std::floor(x) - 0.5);
  }
  return point;
}

// A cell of the polar grid around the exit point, with samples of where in the footprint that point lies.
struct PolarNode {
  float x, y;  // exit minus entry point, mm
  float mass;  // area times the spike's share, mm^2
  std::array<std::array<float, 2>, kFootprintSamples> footprint;
};

std::vector<PolarNode> PolarNodes() {
  constexpr double kPlastic = 1.3247179572447460;  // root of x^3 = x + 1
  constexpr double kGoldenTurn = 0.6180339887498949;
  constexpr double kFirst = 0.5 * SkinGrid::kFirstRadiusMm;
  constexpr int kRings = 30;
  std::vector<PolarNode> nodes;
  auto ring = [&](double inner, double outer, int count, int index) {
    // Within half the table's first radius the kernel is flat; further out S r^1.5 varies slowly, so the middle of the
    // logarithm serves.
    const double r = inner > 0.0 ? std::sqrt(inner * outer) : outer / std::numbers::sqrt2;
    const double area = std::numbers::pi * (outer * outer - inner * inner) / count;
    for (int k = 0; k < count; ++k) {
      const double psi = 2.0 * std::numbers::pi * (k + index * kGoldenTurn) / count;
      PolarNode node{static_cast<float>(r * std::cos(psi)),
                     static_cast<float>(r * std::sin(psi)),
                     static_cast<float>(area) * SpikeShare(static_cast<float>(r)),
                     {}};
      for (auto& p : node.footprint) {
        p = EvenPoint<2>(static_cast<int>(nodes.size()) * kFootprintSamples + static_cast<int>(&p - &node.footprint[0]),
                         kPlastic);
      }
      nodes.push_back(node);
    }
  };
  ring(0.0, kFirst, 4, 0);
  const double ratio = std::pow(kSpikeOuterMm / kFirst, 1.0 / kRings);
  for (int i = 0; i < kRings; ++i) {
    const double inner = kFirst * std::pow(ratio, i);
    ring(inner, inner * ratio, inner < 0.12 ? 8 : 16, i + 1);
  }
  SLX_CHECK(nodes.size() <= kMostNodes);
  return nodes;
}

// Bend between the pixels' centres, which lie at half-integers of `at`; that of the border outside.
Eigen::Vector2f BendAt(const NearSurface& surface, const Eigen::Vector2f& at) {
  const float x = std::clamp(at.x() - 0.5F, 0.0F, kNearWindow - 1.001F),
              y = std::clamp(at.y() - 0.5F, 0.0F, kNearWindow - 1.001F);
  const int c = static_cast<int>(x), r = static_cast<int>(y);
  const float fx = x - static_cast<float>(c), fy = y - static_cast<float>(r);
  const Eigen::Vector2f* b = surface.bend.data() + r * kNearWindow + c;
  return (1 - fy) * ((1 - fx) * b[0] + fx * b[1]) + fy * ((1 - fx) * b[kNearWindow] + fx * b[kNearWindow + 1]);
}

}  // namespace

Extent ExtentOf(const TangentSteps& steps, int block) {
  const float cells = static_cast<float>(block * block) / 12.0F, footprint = 1.0F / 12.0F;
  const Eigen::Matrix2f covariance =
      cells * (steps.column * steps.column.transpose() + steps.row * steps.row.transpose()) +
      footprint * (steps.u * steps.u.transpose() + steps.v * steps.v.transpose());
  // Cholesky.
  const float xx = std::sqrt(std::max(covariance(0, 0), 1e-12F)), xy = covariance(0, 1) / xx;
  return {{xx, xy}, {0.0F, std::sqrt(std::max(covariance(1, 1) - xy * xy, 0.0F))}};
}

float SpikeShare(float r_mm) {
  const float t = std::clamp((r_mm - kSpikeInnerMm) / (kSpikeOuterMm - kSpikeInnerMm), 0.0F, 1.0F);
  return 1.0F - t * t * (3.0F - 2.0F * t);
}

void IntegrateSpike(const SkinKernel& kernel, const TangentSteps& steps, const NearSurface& surface,
                    const Eigen::Vector2f& column_row, int first_column, int first_row, NearField& near) {
  static const std::vector<PolarNode> nodes = PolarNodes();
  near.fill(0.0F);
  Eigen::Matrix2f mm_per_px;
  mm_per_px << steps.column, steps.row;
  const Eigen::Matrix2f px_per_mm = mm_per_px.inverse();
  Eigen::Matrix2f footprint;  // camera pixel to projector pixels
  footprint << px_per_mm * steps.u, px_per_mm * steps.v;
  // Rounding to the nearest projector pixel by truncation: the window lies at positive indices.
  const Eigen::Vector2f origin = column_row -
                                 Eigen::Vector2f(static_cast<float>(first_column), static_cast<float>(first_row)) +
                                 Eigen::Vector2f(0.5F, 0.5F);
  // A few nodes a ring sample the kernel's angular structure too coarsely for its sum, which is known exactly.
  static const SkinKernel::RadialWeights kSpike =
      SkinKernel::WeightsOf([](double r) { return SpikeShare(static_cast<float>(r)); });
  std::array<float, kMostNodes> masses;
  float total = 0.0F;
  for (size_t i = 0; i < nodes.size(); ++i) total += masses[i] = nodes[i].mass * kernel(nodes[i].x, nodes[i].y);
  if (!(total > 0.0F)) return;
  const float scale = static_cast<float>(kernel.Integral(kSpike)) / (total * kFootprintSamples);
  for (size_t i = 0; i < nodes.size(); ++i) {
    const PolarNode& node = nodes[i];
    const float mass = scale * masses[i];
    const Eigen::Vector2f on_plane = origin - px_per_mm * Eigen::Vector2f(node.x, node.y);
    const Eigen::Vector2f entry = on_plane - px_per_mm * BendAt(surface, on_plane);
    for (const auto& p : node.footprint) {
      const float c = entry.x() + footprint(0, 0) * p[0] + footprint(0, 1) * p[1],
                  r = entry.y() + footprint(1, 0) * p[0] + footprint(1, 1) * p[1];
      if (c < 0.0F || r < 0.0F || c >= kNearWindow || r >= kNearWindow) continue;
      near[static_cast<int>(r) * kNearWindow + static_cast<int>(c)] += mass;
    }
  }
  for (size_t k = 0; k < near.size(); ++k) near[k] = surface.area[k] > 0.0F ? near[k] / surface.area[k] : 0.0F;
}

float MeanBesideSpike(const SkinKernel& kernel, const TangentSteps& steps, const Eigen::Vector2f& entry_mm) {
  static const auto pairs = [] {
    constexpr double kRoot = 1.1673039782614187;  // of x^5 = x + 1
    std::array<std::array<float, 4>, kSmoothSamples> points{};
    for (int k = 0; k < kSmoothSamples; ++k) points[k] = EvenPoint<4>(k, kRoot);
    return points;
  }();
  float sum = 0.0F;
  for (const auto& p : pairs) {
    const Eigen::Vector2f offset = p[2] * steps.u + p[3] * steps.v - entry_mm - p[0] * steps.column - p[1] * steps.row;
    const float share = 1.0F - SpikeShare(offset.norm());
    if (share > 0.0F) sum += share * kernel(offset.x(), offset.y());
  }
  return sum / kSmoothSamples;
}

}  // namespace stratalux::rig
