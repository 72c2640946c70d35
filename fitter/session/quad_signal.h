// SPDX-License-Identifier: Apache-2.0
// Radiance and its noise on quads, from raw frames.
#pragma once

#include "fitter/session/session_frames.h"
#include "fitter/structured_light/sensor_noise.h"

namespace stratalux::fit {

// Raw level from which on a session's samples are saturated, whatever its calibration says: as its manifest tells, else
// the highest of its frames' format. 0: it has no frames.
[[nodiscard]] double SaturationOf(const SessionFrames& frames);

// Noise of a session's frames: from its own calibration, or what SaturationOf implies. Precondition: it has frames.
[[nodiscard]] SensorNoise NoiseOf(const SessionFrames& frames);

// Mean over each quad's sites of a colour of (raw - dark), digital numbers; NaN where a site is saturated.
[[nodiscard]] Image<float> QuadSignal(ImageView<const uint16_t> raw, ImageView<const float> dark,
                                      const CameraCalibration& camera);
// Variance of QuadSignal: shot noise of all light that arrived and read noise, digital numbers squared.
[[nodiscard]] Image<float> QuadVariance(ImageView<const uint16_t> raw, const CameraCalibration& camera);

}  // namespace stratalux::fit
