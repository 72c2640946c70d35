// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "shared/image/image.h"

namespace stratalux::fit {

// Local Wiener filter [Lee 1980]: each value becomes the mean of its window, (2 reach + 1)^2 pixels of the same
// channel, plus its own deviation times the share of the window's variance that noise does not explain. W x H x C;
// `variance`: of each value's noise, same shape. NaN, in either, stays NaN and has no part in any window. One of
// infinite variance has no part either and becomes its window's mean: NaN where fewer than two others are known. What
// stands out of the noise stays; what noise alone makes goes.
[[nodiscard]] Image<float> ShrinkNoise(const Image<float>& values, const Image<float>& variance, int reach);

}  // namespace stratalux::fit
