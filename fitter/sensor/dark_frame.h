// SPDX-License-Identifier: Apache-2.0
// The dark frame (ambient light, black level, the projector's own black) that every other frame is read against. Its
// noise enters all samples of a sweep alike, so that a cycle's sum carries it as many times over as the cycle has
// frames: it must be far quieter than one frame.
#pragma once

#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// `mean_dn`: raw mosaic, mean of `count` black frames. Light that falls on the skin while the projector shows black is
// smooth, pixels differ by the sensor's fixed pattern: each site becomes the mean of its neighbours of the same colour
// (5 x 5 sites) plus its own deviation times the share of the deviations' variance that noise does not explain
// (Wiener). Deviations beyond six standard deviations of the noise (hot pixels, edges) stay whole.
[[nodiscard]] Image<float> QuietDarkFrame(const Image<float>& mean_dn, int count, const CameraCalibration& camera);

}  // namespace stratalux::fit
