// SPDX-License-Identifier: Apache-2.0
#include "fitter/image/on_quads.h"

#include <algorithm>
#include <cmath>

namespace stratalux::fit {

Image<float> OnQuads(ImageView<const float> pooled, int pool, int width, int height) {
  Image<float> quads(width, height, pooled.channels(), std::nanf(""));
  for (int j = 0; j < std::min(height, pooled.height() * pool); ++j)
    for (int i = 0; i < std::min(width, pooled.width() * pool); ++i)
      for (int c = 0; c < pooled.channels(); ++c) quads(i, j, c) = pooled(i / pool, j / pool, c);
  return quads;
}

}  // namespace stratalux::fit
