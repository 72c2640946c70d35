// SPDX-License-Identifier: Apache-2.0
// One light's samples of ONE profile in double precision: what is asked of single profiles (standard errors, how well a
// light left out is predicted, the layers of measured line-spread profiles) needs no lanes.
#pragma once

#include <cstdint>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/line_response.h"
#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

// Sample k at u = first_u + k step.
struct ProfileLight {
  std::vector<double> y;
  double first_u_mm = 0.0, step_mm = 0.0;
  bool wrapped = false;
  LineResponse line;         // cell_mm is that of the fine grid
  int cells_per_sample = 1;  // of the fine grid
  double counts = 1.0;       // photons per unit of y
  double read_shift = 0.0;   // sigma_read^2 in units of y: added to data and model (shifted Poisson)
  double s = 0.0;            // shift per mm of depth
  double fresnel = 1.0;      // the angular gain is fresnel exp(-tau gain_path)
  double gain_path = 0.0;
  RefractedDirections directions;
  double reflected = -1.0;      // by the surface, reflectance; negative: unknown
  double white_variance = 0.0;  // of the white frames, in units of the samples' sum; 0: there are none

  [[nodiscard]] int samples() const { return static_cast<int>(y.size()); }
  [[nodiscard]] double Gain(double tau) const;
};

// The light `batch` holds of `profile`, on the grid that FitMixture uses.
[[nodiscard]] ProfileLight ProfileLightOf(const SrdBatch& batch, int64_t profile, const EmOptions& options);

}  // namespace stratalux::fit
