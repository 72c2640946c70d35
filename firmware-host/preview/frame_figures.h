// SPDX-License-Identifier: Apache-2.0
// What whoever focuses and aims goes by, of one frame.
#pragma once

#include <cstdint>

#include "shared/image/image.h"

namespace stratalux::rig {

struct FrameFigures {
  double level = 0.0;      // median of all samples, of the saturation
  double bright = 0.0;     // what one sample in a hundred reaches, of the saturation
  double saturated = 0.0;  // share of the samples that reach the saturation
  // Of the middle half (by width and height) of quads, means of 2 x 2 samples: the variance of the Laplacian
  // q(x-1,y) + q(x+1,y) + q(x,y-1) + q(x,y+1) - 4 q(x,y) (Pech-Pacheco et al., ICPR 2000, eq. 4), over the square of
  // their mean, so that another exposure changes it by noise alone. The sharper, the greater; 0 where it is black. Two
  // values are comparable of the same scene under the same light.
  double focus = 0.0;
};

// A mosaic or a plain picture, one channel, at least 16 x 16; smaller: all 0. `saturation_dn` > 0.
[[nodiscard]] FrameFigures FiguresOf(ImageView<const uint16_t> frame, double saturation_dn);

}  // namespace stratalux::rig
