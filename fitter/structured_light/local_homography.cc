// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/local_homography.h"

#include <Eigen/Cholesky>
#include <array>
#include <cmath>
#include <vector>

#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

// What a site's sigma does not tell: the homography is not quite the surface.
constexpr double kModelVariancePx2 = 0.01;

struct Pair {
  Eigen::Vector2d from;  // camera, about the wanted point, in window radii
  Eigen::Vector2d to;    // projector px, about the window's mean
  double weight = 1.0;   // 1 / px^2
};

// (h0 x + h1 y + h2, h3 x + h4 y + h5) / (h6 x + h7 y + 1): the denominator cannot vanish at the window's centre.
using Homography = Eigen::Matrix<double, 8, 1>;

Eigen::Vector2d Apply(const Homography& h, const Eigen::Vector2d& p) {
  const double w = h[6] * p.x() + h[7] * p.y() + 1.0;
  return {(h[0] * p.x() + h[1] * p.y() + h[2]) / w, (h[3] * p.x() + h[4] * p.y() + h[5]) / w};
}

// Weighted least squares of the linearised equations over the chosen pairs.
template <typename Indices>
std::optional<Homography> Fit(const std::vector<Pair>& pairs, const Indices& chosen) {
  Eigen::Matrix<double, 8, 8> normal = Eigen::Matrix<double, 8, 8>::Zero();
  Homography right = Homography::Zero();
  for (const auto i : chosen) {
    const double x = pairs[i].from.x(), y = pairs[i].from.y();
    const double u = pairs[i].to.x(), v = pairs[i].to.y();
    Homography a, b;
    a << x, y, 1, 0, 0, 0, -u * x, -u * y;
    b << 0, 0, 0, x, y, 1, -v * x, -v * y;
    normal += pairs[i].weight * (a * a.transpose() + b * b.transpose());
    right += pairs[i].weight * (u * a + v * b);
  }
  const Eigen::LDLT<Eigen::Matrix<double, 8, 8>> solver(normal);
  const Homography h = solver.solve(right);
  if (solver.info() != Eigen::Success || !h.allFinite()) return std::nullopt;
  return h;
}

std::vector<int> Inliers(const std::vector<Pair>& pairs, const Homography& h, double inlier_px) {
  std::vector<int> inliers;
  for (int i = 0; i < static_cast<int>(pairs.size()); ++i)
    if ((Apply(h, pairs[i].from) - pairs[i].to).norm() < inlier_px) inliers.push_back(i);
  return inliers;
}

std::vector<Pair> CollectPairs(const DecodedMap& map, const Eigen::Vector2d& camera_px, int radius) {
  std::vector<Pair> pairs;
  const int cx = static_cast<int>(std::lround(camera_px.x())), cy = static_cast<int>(std::lround(camera_px.y()));
  for (int y = cy - radius; y <= cy + radius; ++y)
    for (int x = cx - radius; x <= cx + radius; ++x) {
      if (!map.reason.contains(x, y) || map.reason(x, y) != static_cast<uint8_t>(DecodeReason::kValid)) continue;
      if (std::isnan(map.column(x, y)) || std::isnan(map.row(x, y))) continue;
      const double variance = std::pow(map.column_sigma(x, y), 2) + std::pow(map.row_sigma(x, y), 2);
      pairs.push_back({(Eigen::Vector2d(x, y) - camera_px) / radius,
                       {map.column(x, y), map.row(x, y)},
                       1.0 / (variance + kModelVariancePx2)});
    }
  return pairs;
}

}  // namespace

std::optional<ProjectorPoint> LookUpProjectorPoint(const DecodedMap& map, const Eigen::Vector2d& camera_px,
                                                   const LocalHomographyOptions& options) {
  std::vector<Pair> pairs = CollectPairs(map, camera_px, options.radius_px);
  const size_t count = pairs.size();
  if (count < static_cast<size_t>(std::max(options.min_sites, 4))) return std::nullopt;
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Pair& pair : pairs) mean += pair.to / static_cast<double>(count);
  for (Pair& pair : pairs) pair.to -= mean;

  Random random(count);
  std::vector<int> best;
  for (int trial = 0; trial < options.trials; ++trial) {
    std::array<size_t, 4> sample{};
    for (size_t& i : sample) i = static_cast<size_t>(random.Uniform() * static_cast<double>(count));
    const auto h = Fit(pairs, sample);
    if (!h) continue;
    std::vector<int> inliers = Inliers(pairs, *h, options.inlier_px);
    if (inliers.size() > best.size()) best = std::move(inliers);
  }
  std::optional<Homography> refined;
  for (int round = 0; round < 3; ++round) {
    if (static_cast<double>(best.size()) < std::max(8.0, options.min_inliers * static_cast<double>(count)))
      return std::nullopt;
    refined = Fit(pairs, best);
    if (!refined) return std::nullopt;
    best = Inliers(pairs, *refined, options.inlier_px);
  }
  double sum = 0.0, weight = 0.0;
  for (int i : best) {
    sum += pairs[i].weight * (Apply(*refined, pairs[i].from) - pairs[i].to).squaredNorm();
    weight += pairs[i].weight;
  }
  const int inliers = static_cast<int>(best.size());
  if (inliers == 0) return std::nullopt;
  return ProjectorPoint{mean + Apply(*refined, Eigen::Vector2d::Zero()), inliers, std::sqrt(sum / weight)};
}

}  // namespace stratalux::fit
