// SPDX-License-Identifier: Apache-2.0
// Maps as pictures for people.
#pragma once

#include <cstdint>
#include <string>

#include "shared/image/image.h"

namespace stratalux::fit {

// Linear light -> sRGB bytes (IEC 61966-2-1), `white` maps to 255; a pixel with a NaN in any colour is black.
[[nodiscard]] Image<uint8_t> ToSrgb(ImageView<const float> linear, double white);
// The picture with one channel more: 255 where `covered` (W x H) is not 0, else 0. Straight: colours stay.
[[nodiscard]] Image<uint8_t> WithAlpha(ImageView<const uint8_t> picture, ImageView<const uint8_t> covered);
// Scalar map through a perceptual colour scale between low and high; NaN is dark grey.
[[nodiscard]] Image<uint8_t> ToColourScale(ImageView<const float> map, double low, double high);
// The scale's colours from low to high, as arguments of a CSS linear-gradient.
[[nodiscard]] std::string ColourScaleCss();
// Unit normals (camera frame) as colours: x right red, y up green, towards the viewer blue.
[[nodiscard]] Image<uint8_t> NormalColours(ImageView<const float> normals);
// The value below which the share `fraction` of the finite values lies; 0 when there are none.
[[nodiscard]] double Percentile(ImageView<const float> map, double fraction);

}  // namespace stratalux::fit
