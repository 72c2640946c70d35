// SPDX-License-Identifier: Apache-2.0
// What decoding gives for one projector: sub-pixel projector coordinates per camera pixel, or the reason why not.
#pragma once

#include <cstdint>

#include "shared/image/image.h"

namespace stratalux::fit {

enum class DecodeReason : uint8_t { kValid = 0, kUnlit = 1, kAmbiguous = 2, kSaturated = 3, kMoved = 4, kOutside = 5 };
inline constexpr int kDecodeReasons = 6;
[[nodiscard]] const char* ToString(DecodeReason reason);

// All maps have the size of the camera's frames (every mosaic site is decoded: bit decisions are ratios, so
// colour-free).
struct DecodedMap {
  Image<float> column;  // projector px; NaN where invalid, and everywhere where the axis was not captured
  Image<float> row;
  Image<float> column_sigma;  // standard deviation, px
  Image<float> row_sigma;
  Image<uint8_t> reason;  // DecodeReason
};

}  // namespace stratalux::fit
