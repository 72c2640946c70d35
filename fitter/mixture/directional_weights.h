// SPDX-License-Identifier: Apache-2.0
// Directional weights (beyond [M]; model section 7): how the light of a layer depends on the directions of lamp and
// eye.
//
//   w_lp = w_l exp(-kappa d_l (sec_i + sec_o - 2)) [(1 - m_l) + m_l ph(Theta_p)],   m_l = exp(-sigma_l / sigma_0)
//
// Narrow layers carry light that scattered once or a few times: it follows a Henyey-Greenstein phase function ph (1 at
// backscatter) of the angle Theta between the refracted rays in and out. Deep layers lose light along the oblique path.
#pragma once

#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

struct DirectionalWeights {
  double kappa_per_mm = 0.0;
  double asymmetry = 0.0;  // of ph, -1 < g < 1
  double sigma_0_mm = 0.3;

  // Without effect: every factor is 1.
  [[nodiscard]] bool Off() const { return kappa_per_mm == 0.0 && asymmetry == 0.0; }
};

// The two directions of a light as a layer meets them: refracted into the skin.
struct RefractedDirections {
  double sec_in = 1.0, sec_out = 1.0;
  double cos_scatter = -1.0;  // between the ray in and the ray out; -1: back where it came from

  // Oblique path beyond the straight one, per mm of depth.
  [[nodiscard]] double ExtraPath() const { return sec_in + sec_out - 2.0; }
};

[[nodiscard]] RefractedDirections DirectionsOf(const SrdBatch& batch, int64_t profile, double eta);

// w_lp / w_l.
[[nodiscard]] double DirectionalFactor(const DirectionalWeights& weights, const RefractedDirections& directions,
                                       double depth_mm, double sigma_mm);

}  // namespace stratalux::fit
