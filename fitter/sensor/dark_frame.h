// SPDX-License-Identifier: Apache-2.0
// The dark frame (ambient light, black level, the projector's own black) that every other frame is read against. Its
// noise enters all samples of a sweep alike, so that a cycle's sum carries it as many times over as the cycle has
// frames: it must be far quieter than one frame.
#pragma once

#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// Mean of frames of one picture: raw mosaic; NaN where nothing is known.
struct MeanFrame {
  ImageView<const float> dn;
  int count = 0;
};

// The dark frame without most of its noise, W x H as `black`, the mean of black frames. What a projector's black adds
// is its white, some hundred or thousand times weaker, and ambient light falls on the same skin: around each site black
// is taken for a straight line of `white` (that projector's white frames; a guided filter [He, Sun, Tang 2013]), over
// 31 x 31 sites of the same colour; where no line fits (shadows' edges), by means of what it leaves over 5 x 5 sites
// beside. Where no white is known (none given, NaN, too few sites) the site becomes the mean of its neighbours, 5 x 5.
// Pixels differ by the sensor's fixed pattern beside: to either is added the site's own deviation times the share of
// the deviations' variance that noise does not explain (Wiener), and all of it beyond six standard deviations of the
// noise (hot pixels).
[[nodiscard]] Image<float> QuietDarkFrame(const MeanFrame& black, const CameraCalibration& camera,
                                          const MeanFrame& white = {});

}  // namespace stratalux::fit
