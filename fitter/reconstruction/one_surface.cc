// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/one_surface.h"

#include <Eigen/Geometry>
#include <cmath>

namespace stratalux::fit {

bool OnOneSurface(const Eigen::Vector3d& a_mm, const Eigen::Vector3d& b_mm, double sigma_mm) {
  const double a = a_mm.norm(), b = b_mm.norm();
  const double across_mm = 2.0 * a_mm.cross(b_mm).norm() / (a + b);
  const double noise_mm = std::isnan(sigma_mm) ? 0.0 : kStepSigmas * sigma_mm;
  return std::abs(a - b) <= kMaxSlope * across_mm + noise_mm;
}

bool OnOneSurface(const SurfaceMap& surface, int i, int j, int k, int l) {
  const Eigen::Vector3d a = surface.Point(i, j), b = surface.Point(k, l);
  if (OnOneSurface(a, b, std::hypot(surface.depth_sigma_mm(i, j), surface.depth_sigma_mm(k, l)))) return true;
  const Eigen::Vector3d chord = b - a;
  // False of NaN, whichever of them has it.
  const double most = kMaxChordSine * chord.norm();
  return std::abs(surface.Normal(i, j).dot(chord)) <= most && std::abs(surface.Normal(k, l).dot(chord)) <= most;
}

}  // namespace stratalux::fit
