// SPDX-License-Identifier: Apache-2.0
// Directional weights (beyond [M]; model section 7): how the light of a layer depends on the directions of lamp and
// eye.
//
//   w_lp = w_l exp(-kappa d_l (sec_i + sec_o - 2)) [(1 - m_l) + m_l sec_i sec_o exp(b (1 + cos Theta))],
//   m_l = exp(-sigma_l / sigma_0)
//
// Narrow layers (m near 1) carry light that scattered once or a few times. Per irradiance of the skin, a thin sheet at
// depth z returns sec_i sec_o exp(-mu z (sec_i + sec_o)) times its phase function of the angle Theta between the
// refracted rays in and out; exp(b (1 + cos Theta)), 1 at backscatter, stands for the phase function of few events.
// Wide layers have forgotten the directions but for the attenuation along the oblique path.
#pragma once

#include <Eigen/Core>

#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

struct DirectionalWeights {
  double kappa_per_mm = 0.0;
  double phase_slope = 0.0;  // b
  double sigma_0_mm = 0.0;   // 0: no layer is narrow

  // Without effect: every factor is 1.
  [[nodiscard]] bool Off() const { return kappa_per_mm == 0.0 && sigma_0_mm == 0.0; }
};

// The two directions of a light as a layer meets them: refracted into the skin.
struct RefractedDirections {
  double sec_in = 1.0, sec_out = 1.0;
  double cos_scatter = -1.0;  // between the ray in and the ray out; -1: back where it came from

  // Oblique path beyond the straight one, per mm of depth.
  [[nodiscard]] double ExtraPath() const { return sec_in + sec_out - 2.0; }
};

// omega_in, omega_out: unit vectors from the point to lamp and eye; n . omega > 0.
[[nodiscard]] RefractedDirections DirectionsOf(const Eigen::Vector3d& omega_in, const Eigen::Vector3d& omega_out,
                                               const Eigen::Vector3d& normal, double eta);
[[nodiscard]] RefractedDirections DirectionsOf(const SrdBatch& batch, int64_t profile, double eta);

// w_lp / w_l.
[[nodiscard]] double DirectionalFactor(const DirectionalWeights& weights, const RefractedDirections& directions,
                                       double depth_mm, double sigma_mm);

}  // namespace stratalux::fit
