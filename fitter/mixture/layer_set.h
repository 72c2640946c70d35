// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

namespace stratalux::fit {

// Layers of one profile, or the mean of many; background: over a whole comb cycle, in units of reflectance.
struct LayerSet {
  std::vector<double> weight, depth_mm, sigma_mm;
  double background = 0.0;
};

}  // namespace stratalux::fit
