// SPDX-License-Identifier: Apache-2.0
// Where a site should lie by its neighbours: the plane through their columns (docs/math/geometry.md, eq. 8).
#pragma once

#include <optional>

#include "shared/image/image.h"

namespace stratalux::fit {

struct PlanePrediction {
  double value_px = 0.0;
  double sigma_px = 0.0;
};

// Of the sites around (x, y), itself not among them, that have a value (NaN: none) and lie on one surface with it:
// `about_px` is what its own code says. nullopt where they are too few, or no plane goes through them, as at an edge in
// depth. Reentrant.
[[nodiscard]] std::optional<PlanePrediction> PredictFromNeighbours(ImageView<const float> value,
                                                                   ImageView<const float> sigma, int x, int y,
                                                                   double about_px);

}  // namespace stratalux::fit
