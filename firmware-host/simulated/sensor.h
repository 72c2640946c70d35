// SPDX-License-Identifier: Apache-2.0
// The simulated camera's electronics: shot and read noise, black level, 12 bits, saturation.
#pragma once

#include <cstdint>

#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"

namespace stratalux::rig {

struct SensorOptions {
  bool noise = true;
  uint64_t seed = 1;
};

// Digital numbers above black (noise-free) -> raw frame. Counter-based: the noise of frame `number` depends on nothing
// before it.
[[nodiscard]] Image<uint16_t> ExposeSensor(const Image<float>& light_dn, const CameraCalibration& camera,
                                           int64_t number, const SensorOptions& options);

}  // namespace stratalux::rig
