// SPDX-License-Identifier: Apache-2.0
// The box that a camera pixel averages over, along one of its axes; unit: the pixel.
#pragma once

namespace stratalux {

inline constexpr double kBoxVariance = 1.0 / 12.0;
// Two Gaussians at -kHalfBoxPlace and +kHalfBoxPlace, of this variance: their mean has the box's moments up to the
// fifth (place^2 + variance = 1/12; place^4 + 6 place^2 variance + 3 variance^2 = 1/80, hence place^4 = 1/240).
inline constexpr double kHalfBoxPlace = 0.25406757;
inline constexpr double kHalfBoxVariance = kBoxVariance - kHalfBoxPlace * kHalfBoxPlace;

// Share of a line's variance up to which a pixel's box is taken for a Gaussian. The Gaussian lacks 1.2 of the square of
// it of the fourth cumulant, and an eighth of that, 0.6 %, of the peak.
inline constexpr double kShortBox = 0.2;
// Whether a box is longer, its side and the optics' variance given in the light's pixels; the line is one of them wide.
[[nodiscard]] constexpr bool IsLongBox(double side_px, double optics_px2) {
  const double box = kBoxVariance * side_px * side_px;
  return box > kShortBox * (optics_px2 + kBoxVariance + box);
}

}  // namespace stratalux
