// SPDX-License-Identifier: Apache-2.0
// The brushes that shapes and skins are drawn with.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace stratalux::rig {

// exp(-((x - cx) / sx)^2 - ((y - cy) / sy)^2) * amplitude.
struct Bump {
  double cx = 0, cy = 0, sx = 1, sy = 1, amplitude = 0;
  [[nodiscard]] double At(double x, double y) const {
    const double u = (x - cx) / sx, v = (y - cy) / sy;
    const double q = u * u + v * v;
    return q > 30.0 ? 0.0 : amplitude * std::exp(-q);
  }
};

[[nodiscard]] inline double Sum(const std::vector<Bump>& bumps, double x, double y) {
  double sum = 0.0;
  for (const Bump& b : bumps) sum += b.At(x, y);
  return sum;
}

using Polyline = std::vector<Eigen::Vector2d>;

// Infinity for a line of fewer than two points.
[[nodiscard]] inline double DistanceTo(const Polyline& line, const Eigen::Vector2d& p) {
  double best = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i + 1 < line.size(); ++i) {
    const Eigen::Vector2d d = line[i + 1] - line[i];
    const double t = std::clamp((p - line[i]).dot(d) / d.squaredNorm(), 0.0, 1.0);
    best = std::min(best, (p - line[i] - t * d).norm());
  }
  return best;
}

}  // namespace stratalux::rig
