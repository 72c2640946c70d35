// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/surface_map.h"

#include <algorithm>
#include <vector>

namespace stratalux::fit {

double QuadSpacingMm(const SurfaceMap& surface) {
  std::vector<double> spacings;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 1; i < surface.width(); ++i)
      if (surface.mask(i, j) != 0 && surface.mask(i - 1, j) != 0)
        spacings.push_back((surface.Point(i, j) - surface.Point(i - 1, j)).norm());
  if (spacings.empty()) return 0.0;
  const auto middle = spacings.begin() + std::ssize(spacings) / 2;
  std::nth_element(spacings.begin(), middle, spacings.end());
  return *middle;
}

}  // namespace stratalux::fit
