// SPDX-License-Identifier: Apache-2.0
// Reads the marker code of the pre-roll back from the mean levels of its frames (docs/capture-plan.md).
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "shared/image/image.h"

namespace stratalux::rig {

struct PrerollReading {
  bool decoded = false;  // the frames show the code, frame by frame
  std::string reason;    // for people, when not decoded: by how many frames the code is shifted, or what was read
};

// `mean_dn`: mean raw level of each marker frame, in order. `code`: true = white (PrerollCode). White and dark count as
// told apart when they differ by at least `min_contrast_dn`.
[[nodiscard]] PrerollReading ReadPreroll(std::span<const double> mean_dn, const std::vector<bool>& code,
                                         double min_contrast_dn);

// The marker whose picture differs most from the others of its kind, and by how much: the share of its pixels, in the
// worst band of rows, that lie more than 10 % and 5 noise deviations (sqrt of `variance(dn)`) from their median.
// {-1, 0} where no kind has three markers.
struct OddMarker {
  int marker = -1;
  double share = 0.0;
};
[[nodiscard]] OddMarker FindOddMarker(std::span<const Image<uint16_t>* const> frames, const std::vector<bool>& code,
                                      const std::function<double(double dn)>& variance);

}  // namespace stratalux::rig
