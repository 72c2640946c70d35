// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/pits.h"

#include <cmath>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

// Depth (1 - (d / r)^2)^3 within radius r, which is close to exp(-d^2 / (2 sigma^2)) of r = sqrt(6) sigma, the head's
// pores having sigma 0.12 mm.
constexpr double kBallMm = 0.294;
// One ball in each cell of a jittered lattice: a plane cuts 1.1 a mm^2 within sigma of their middles; the head has 1.2.
constexpr double kLatticeMm = 0.6;
static_assert(kBallMm + Pits::kReachMm <= kLatticeMm, "a point's balls lie in the cells beside its own");

// Three numbers of 21 bits each, behind the small numbers that name the other streams of a seed.
uint64_t StreamOf(const Eigen::Vector3i& cell) {
  uint64_t stream = 1;
  for (int k = 0; k < 3; ++k) stream = stream << 21 | (static_cast<uint64_t>(cell[k]) & 0x1fffffU);
  return stream;
}

}  // namespace

Pits::Pits(const Eigen::Vector3d& centre, uint64_t seed) {
  const Eigen::Vector3i own = (centre / kLatticeMm).array().floor().cast<int>();
  for (int k = 0; k < 27; ++k) {
    const Eigen::Vector3i cell = own + Eigen::Vector3i(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
    Random random(seed, StreamOf(cell));
    Eigen::Vector3d at;
    for (int axis = 0; axis < 3; ++axis) at[axis] = (cell[axis] + random.Uniform()) * kLatticeMm;
    if ((at - centre).norm() < kBallMm + kReachMm) balls_.push_back({at, random.Uniform(0.3, 1.0)});
  }
}

Pits::Depth Pits::At(const Eigen::Vector3d& point) const {
  Depth sum;
  for (const Ball& ball : balls_) {
    const Eigen::Vector3d d = point - ball.centre;
    const double q = 1.0 - d.squaredNorm() / (kBallMm * kBallMm);
    if (q <= 0.0) continue;
    sum.depth += ball.depth * q * q * q;
    sum.slope -= (6.0 * ball.depth * q * q / (kBallMm * kBallMm)) * d;
  }
  return sum;
}

}  // namespace stratalux::rig
