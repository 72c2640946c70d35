// SPDX-License-Identifier: Apache-2.0
// What the held-out light's own sinusoids show of the very surface.
#pragma once

#include "fitter/pipeline/holdout.h"

namespace stratalux::fit {

// Reflectance of the very surface under the held-out light, W x H x C on quads; NaN where unknown. Its measured direct
// image, the mean of the sinusoids along both axes, holds the surface's light and what of the layers' their periods
// still resolve (docs/math/evaluation.md). Noise of the direct image is shrunk towards the neighbours.
[[nodiscard]] Image<float> MeasuredSurface(const HoldOutInput& input, const MixtureMap& map);

}  // namespace stratalux::fit
