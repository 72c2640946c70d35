// SPDX-License-Identifier: Apache-2.0
// The EM inner loops for a block of profiles, one profile a SIMD lane: the fine-grid form of model section 7. All
// arrays are [index][lane]; positions and widths are in cells of the lane's own grid, the pixel's own entry point (u =
// 0) at `origin`.
#pragma once

#include <vector>

#include "fitter/mixture/simd.h"

namespace stratalux::fit {

struct EmGrid {
  int cells = 0;
  bool wrapped = true;
};

// mass[cells][lane] += sum over layers of weight_l N(cell; mean_l, sigma_l).
void AddLayers(const EmGrid& grid, int layers, const float* weight, const float* mean, const float* sigma, float* mass);

// moments[layer][3][lane] = sum over cells of q m_l {1, z - mean_l, (z - mean_l)^2}, z in cells.
void LayerMoments(const EmGrid& grid, int layers, const float* weight, const float* mean, const float* sigma,
                  const float* q, float* moments);

}  // namespace stratalux::fit
