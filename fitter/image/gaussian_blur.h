// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "shared/image/image.h"

namespace stratalux::fit {

// Its weights along an axis, at -3 sigma .. 3 sigma; they add up to 1.
[[nodiscard]] std::vector<float> GaussianTaps(double sigma_px);

// Of white noise, the share of its variance that is left when its blur is taken off.
[[nodiscard]] double NoiseAboveBlur(double sigma_px);

// Each channel by a Gaussian of `sigma_px`, cut off at three of them; outside the image is zero. Thread-count
// independent.
[[nodiscard]] Image<float> GaussianBlur(const Image<float>& image, double sigma_px);

}  // namespace stratalux::fit
