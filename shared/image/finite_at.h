// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

#include "shared/image/image.h"

namespace stratalux {

// Whether every channel of the pixel is a number, not NaN and not infinite.
[[nodiscard]] inline bool FiniteAt(ImageView<const float> image, int x, int y) {
  for (int c = 0; c < image.channels(); ++c)
    if (!std::isfinite(image(x, y, c))) return false;
  return true;
}

}  // namespace stratalux
