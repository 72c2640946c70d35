// SPDX-License-Identifier: Apache-2.0
#include "fitter/structured_light/neighbour_plane.h"

#include <Eigen/Cholesky>
#include <cmath>

namespace stratalux::fit {
namespace {

constexpr int kReach = 2;             // sites to either side: so small a piece of skin is plane
constexpr double kSteepest_px = 2.0;  // a site; on steeper ground the finest stripes fall between the sites
constexpr int kMinNeighbours = 8;     // a third of them
constexpr double kMaxMisfit = 2.0;    // chi^2 a degree of freedom
constexpr double kAgreeingSigmas = 3.0;

}  // namespace

std::optional<PlanePrediction> PredictFromNeighbours(ImageView<const float> value, ImageView<const float> sigma, int x,
                                                     int y, double about_px) {
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  double squares = 0.0;
  int count = 0;
  for (int j = -kReach; j <= kReach; ++j)
    for (int i = -kReach; i <= kReach; ++i) {
      if ((i == 0 && j == 0) || !value.contains(x + i, y + j) || std::isnan(value(x + i, y + j))) continue;
      const double at = value(x + i, y + j) - about_px;
      const double s = sigma(x + i, y + j);
      if (std::abs(at) > kSteepest_px * std::hypot(i, j) + kAgreeingSigmas * s) continue;
      const Eigen::Vector3d basis(1.0, i, j);
      normal += basis * basis.transpose() / (s * s);
      right += basis * (at / (s * s));
      squares += at * at / (s * s);
      ++count;
    }
  if (count < kMinNeighbours) return std::nullopt;
  const Eigen::LLT<Eigen::Matrix3d> solver(normal);
  if (solver.info() != Eigen::Success) return std::nullopt;
  const Eigen::Vector3d plane = solver.solve(right);
  const double misfit = (squares - plane.dot(right)) / (count - 3);
  if (!(misfit < kMaxMisfit)) return std::nullopt;
  // The quantisation's 1/12 is in what the plane leaves over, or, where all sites lie alike in their columns, in the
  // plane itself.
  const double shared = std::max(0.0, 1.0 - misfit) / 12.0;
  const double own = solver.solve(Eigen::Vector3d::UnitX()).x();
  return PlanePrediction{about_px + plane.x(), std::sqrt(own + shared)};
}

}  // namespace stratalux::fit
