// SPDX-License-Identifier: Apache-2.0
// The simulated camera's lens and electronics: blur, vignetting, fixed pattern, dark current, shot and read noise,
// blooming, compression, black level, quantisation, saturation.
#pragma once

#include <cstdint>

#include "firmware-host/simulated/device_options.h"
#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"

namespace stratalux::rig {

enum class Noise { kOff, kOn };

struct SensorOptions {
  CameraElectronics electronics;
  Noise noise = Noise::kOn;
  uint64_t seed = 1;  // of the noise; the fixed pattern is the camera's own and the same for all seeds
};

struct SensorExposure {
  double exposure_ms = 16.0;
  double gain = 1.0;   // analogue; `light` is given as it would read at this gain
  int64_t number = 0;  // noise is counter-based: that of one frame depends on nothing before it
};

// Reentrant.
class Sensor {
 public:
  Sensor(const Pinhole& camera, const SensorOptions& options);

  // `light`: digital numbers above black of a perfect camera, height x width; 12-bit raw frame.
  [[nodiscard]] Image<uint16_t> Expose(Image<float> light, const SensorExposure& exposure) const;

 private:
  void MakeFixedPattern(const Pinhole& camera);
  // Lens, fixed pattern, dark signal and the full well: everything before the noise.
  void AddVices(Image<float>& light, const SensorExposure& exposure) const;
  void Blur(Image<float>& light) const;
  void Bloom(Image<float>& light) const;

  SensorOptions options_;
  Image<float> sensitivity_;  // vignetting x PRNU; empty: 1 everywhere
  Image<float> offset_dn_;    // DSNU; empty: 0
  Image<float> hot_dn_per_ms_;
  float top_, step_;  // largest value, quantisation step, in 12-bit numbers
};

}  // namespace stratalux::rig
