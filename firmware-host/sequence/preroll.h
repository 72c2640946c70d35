// SPDX-License-Identifier: Apache-2.0
// Reads the marker code of the pre-roll back from the mean levels of its frames (docs/capture-plan.md).
#pragma once

#include <span>
#include <string>
#include <vector>

namespace stratalux::rig {

struct PrerollReading {
  bool decoded = false;  // the frames show the code, frame by frame
  std::string reason;    // for people, when not decoded: by how many frames the code is shifted, or what was read
};

// `mean_dn`: mean raw level of each marker frame, in order. `code`: true = white (PrerollCode). White and dark count as
// told apart when they differ by at least `min_contrast_dn`.
[[nodiscard]] PrerollReading ReadPreroll(std::span<const double> mean_dn, const std::vector<bool>& code,
                                         double min_contrast_dn);

}  // namespace stratalux::rig
