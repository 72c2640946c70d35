// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/directional_weights.h"

#include <algorithm>
#include <cmath>

namespace stratalux::fit {
namespace {

// Unit vector inside the skin of an outer direction with tangential slopes (along, across): Snell keeps the tangent's
// sense and divides its sine by eta. z is along the normal.
struct Inside {
  double along, across, z;
};
Inside Refract(double along, double across, double eta) {
  const double per_sine = 1.0 / (eta * std::sqrt(1.0 + along * along + across * across));
  const double x = along * per_sine, y = across * per_sine;
  return {x, y, std::sqrt(std::max(1.0 - x * x - y * y, 1e-6))};
}

}  // namespace

RefractedDirections DirectionsOf(const Eigen::Vector3d& omega_in, const Eigen::Vector3d& omega_out,
                                 const Eigen::Vector3d& normal, double eta) {
  // Snell: the tangential parts shrink by eta.
  const Eigen::Vector3d in = (omega_in - normal.dot(omega_in) * normal) / eta,
                        out = (omega_out - normal.dot(omega_out) * normal) / eta;
  const double z_in = std::sqrt(std::max(1.0 - in.squaredNorm(), 1e-6)),
               z_out = std::sqrt(std::max(1.0 - out.squaredNorm(), 1e-6));
  return {1.0 / z_in, 1.0 / z_out, -(in.dot(out) + z_in * z_out)};
}

RefractedDirections DirectionsOf(const SrdBatch& batch, int64_t profile, double eta) {
  const Inside in = Refract(batch.slope_in[profile], batch.slope_in_across[profile], eta);
  const Inside out = Refract(batch.slope_out[profile], batch.slope_out_across[profile], eta);
  // Both slopes point away from the skin: the ray in travels against its own.
  return {1.0 / in.z, 1.0 / out.z, -(in.along * out.along + in.across * out.across + in.z * out.z)};
}

double DirectionalFactor(const DirectionalWeights& weights, const RefractedDirections& directions, double depth_mm,
                         double sigma_mm) {
  if (weights.Off()) return 1.0;
  const double narrow = weights.sigma_0_mm > 0.0 ? std::exp(-sigma_mm / weights.sigma_0_mm) : 0.0;
  const double few_events =
      directions.sec_in * directions.sec_out * std::exp(weights.phase_slope * (1.0 + directions.cos_scatter));
  return std::exp(-weights.kappa_per_mm * depth_mm * directions.ExtraPath()) * (1.0 + narrow * (few_events - 1.0));
}

}  // namespace stratalux::fit
