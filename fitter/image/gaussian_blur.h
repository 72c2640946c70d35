// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "shared/image/image.h"

namespace stratalux::fit {

// Each channel by a Gaussian of `sigma_px`, cut off at three of them; outside the image is zero. Thread-count
// independent.
[[nodiscard]] Image<float> GaussianBlur(const Image<float>& image, double sigma_px);

}  // namespace stratalux::fit
