// SPDX-License-Identifier: Apache-2.0
// Noise of one raw sample: shot noise, read noise and quantisation (docs/math/geometry.md, eq. 1).
#pragma once

#include <algorithm>

#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

// All levels are raw digital numbers.
struct SensorNoise {
  double black_level_dn = 0.0;
  double saturation_dn = 4095.0;  // samples at or above are saturated
  double gain_e_per_dn = 1.0;
  double read_noise_dn = 0.0;  // standard deviation

  [[nodiscard]] static SensorNoise From(const CameraCalibration& camera) {
    return {camera.black_level_dn, camera.saturation_dn, camera.gain_e_per_dn, camera.read_noise_dn};
  }
  // var = read^2 + signal / gain + 1/12, dn^2.
  [[nodiscard]] double VarianceDn2(double raw_dn) const {
    return read_noise_dn * read_noise_dn + std::max(raw_dn - black_level_dn, 0.0) / gain_e_per_dn + 1.0 / 12.0;
  }
};

}  // namespace stratalux::fit
