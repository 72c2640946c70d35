// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

namespace stratalux::rig {

// Linear light of a coded value, both 0 .. 1 (IEC 61966-2-1).
[[nodiscard]] inline double LinearFromSrgb(double v) {
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}

}  // namespace stratalux::rig
