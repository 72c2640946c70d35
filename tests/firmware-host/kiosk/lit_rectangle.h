// SPDX-License-Identifier: Apache-2.0
// What a camera sees of a subject, without one.
#pragma once

#include <cstdint>

#include "shared/image/image.h"

namespace stratalux::rig {

inline const Image<uint16_t> kDarkPicture(320, 240, 1, uint16_t{64});

// White of a projector: `level` within the rectangle, dark elsewhere.
inline Image<uint16_t> LitRectangle(int left, int top, int right, int bottom, uint16_t level) {
  Image<uint16_t> image = kDarkPicture;
  for (int y = top; y < bottom; ++y)
    for (int x = left; x < right; ++x) image(x, y) = level;
  return image;
}

}  // namespace stratalux::rig
