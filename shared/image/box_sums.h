// SPDX-License-Identifier: Apache-2.0
// Sums over squares, in a time that does not depend on their size.
#pragma once

#include "shared/image/image.h"

namespace stratalux {

// Of each channel, over the (2 radius + 1)^2 pixels around each pixel, as far as the image goes. Values must be finite:
// a sum slides from pixel to pixel. On all cores, same bits for any number of them.
[[nodiscard]] Image<double> BoxSums(const Image<double>& values, int radius);

}  // namespace stratalux
