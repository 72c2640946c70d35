// SPDX-License-Identifier: Apache-2.0
// The box that a camera pixel averages over, along one of its axes; unit: the pixel.
#pragma once

namespace stratalux {

inline constexpr double kBoxVariance = 1.0 / 12.0;
// Two Gaussians at -kHalfBoxPlace and +kHalfBoxPlace, of this variance: their mean has the box's moments up to the
// fifth (place^2 + variance = 1/12; place^4 + 6 place^2 variance + 3 variance^2 = 1/80, hence place^4 = 1/240).
inline constexpr double kHalfBoxPlace = 0.25406757;
inline constexpr double kHalfBoxVariance = kBoxVariance - kHalfBoxPlace * kHalfBoxPlace;

}  // namespace stratalux
