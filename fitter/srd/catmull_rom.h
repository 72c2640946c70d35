// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>

namespace stratalux::fit {

// Weights of the four neighbours of a position `f` in [0, 1) after the second one (Catmull & Rom): cubic, through the
// samples and without blur (its kernel has no second moment, where linear interpolation widens by a third of a pixel).
[[nodiscard]] inline std::array<double, 4> CatmullRomWeights(double f) {
  const double f2 = f * f, f3 = f2 * f;
  return {-0.5 * f + f2 - 0.5 * f3, 1.0 - 2.5 * f2 + 1.5 * f3, 0.5 * f + 2.0 * f2 - 1.5 * f3, -0.5 * f2 + 0.5 * f3};
}

}  // namespace stratalux::fit
