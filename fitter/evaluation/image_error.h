// SPDX-License-Identifier: Apache-2.0
// Figures of merit of model section 9.
#pragma once

#include <array>
#include <cstdint>

#include "shared/image/image.h"

namespace stratalux::fit {

struct ImageError {
  double nrmse = 0.0;  // RMS(error) / RMS(reference), all channels together
  std::array<double, 3> nrmse_channel{};
  double bias = 0.0;     // sum of the errors over the sum of the reference, all channels together
  double psnr_db = 0.0;  // peak = 99.9th percentile of the reference
  double ssim = 0.0;     // Gaussian 11 x 11, sigma 1.5, same peak, windows wholly inside the mask; mean of channels
  int64_t pixels = 0;    // of the mask that are finite in both images
};

// Images W x H x C, mask W x H. Pixels that are not finite in either image do not count; where none is left every
// figure is NaN.
[[nodiscard]] ImageError CompareImages(ImageView<const float> reference, ImageView<const float> estimate,
                                       ImageView<const uint8_t> mask);

// What `nrmse` of a perfect estimate would be against a reference whose every value carries noise of `variance` (same
// shape): RMS(noise) / RMS(reference) over the mask's pixels that are finite in all
// channels of both. NaN where there are none.
[[nodiscard]] double NoiseFloor(ImageView<const float> reference, ImageView<const float> variance,
                                ImageView<const uint8_t> mask);

// How two masks agree, in pixels where a third one counts.
struct MaskOverlap {
  int64_t both = 0, only_estimate = 0, only_reference = 0;
  [[nodiscard]] double IntersectionOverUnion() const;  // NaN: neither has a pixel
};
[[nodiscard]] MaskOverlap CompareMasks(ImageView<const uint8_t> reference, ImageView<const uint8_t> estimate,
                                       ImageView<const uint8_t> where);

}  // namespace stratalux::fit
