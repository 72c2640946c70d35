// SPDX-License-Identifier: Apache-2.0
// What a camera's picture of skin is compared by (docs/math/motion.md, eq. 1).
#pragma once

#include "shared/image/image.h"

namespace stratalux::fit {

// Normalised convolution with a Gaussian: mean of the values that are finite, NaN where none of it lies on them.
// `share` (if given) receives how much of the Gaussian does. Each channel is taken where the first one is finite.
[[nodiscard]] Image<float> BlurredOver(const Image<float>& values, double sigma_quads, Image<float>* share = nullptr);

// Mean of n x n quads, of those that are finite; NaN where fewer than half are.
[[nodiscard]] Image<float> Binned(const Image<float>& image, int n);

// W x H: logarithm of the light, mean over colours, by a Gaussian of `sigma_quads` over the quads that have light; NaN
// where there is none, or most of the Gaussian lies on none. `light`: W x H x C, digital numbers above black, NaN where
// saturated; `lit`: 1 where it may be used.
[[nodiscard]] Image<float> LogLight(const Image<float>& light, const Image<uint8_t>& lit, double sigma_quads);

}  // namespace stratalux::fit
