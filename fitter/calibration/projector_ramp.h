// SPDX-License-Identifier: Apache-2.0
// A projector's response from its grey ramp (docs/math/calibration.md, "Light").
#pragma once

#include <vector>

#include "shared/base/result.h"

namespace stratalux::fit {

// Light above black, summed over the places that count, in the order of capture.
struct RampFrame {
  double grey = 0.0;  // 0 .. 1; 1 is white
  double light = 0.0;
  int step = 0;  // of the plan: time, for the lamp's drift
};

struct ProjectorRamp {
  std::vector<double> response;    // ProjectorCalibration::response
  double largest_deviation = 0.0;  // from a straight line
  double lamp_drift = 0.0;         // largest change of white, relative to the first
  double worst_fall = 0.0;         // by which the ramp fell anywhere, share of white
};

// Each level over white of its time, interpolated between the whites about it; then the rising curve nearest to it,
// from 0 to 1. kFailed: no white, or levels that are not those of an even ramp.
[[nodiscard]] Result<ProjectorRamp> FitProjectorRamp(const std::vector<RampFrame>& frames);

}  // namespace stratalux::fit
