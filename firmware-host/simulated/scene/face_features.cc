// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/face_features.h"

#include "shared/base/random.h"

namespace stratalux::rig {

// Proportions of an adult face in mm; every length and height varies by seed.
FaceFeatures FaceFeatures::Of(const HeadDescription& d, uint64_t seed) {
  Random random(seed, 1);
  auto vary = [&](double v) { return v * random.Uniform(1.0 - d.variation, 1.0 + d.variation); };
  // A call, not braces: with them the draws of one feature would come in another order, and every seed's face be
  // another one.
  auto feature = [](double cx, double cy, double sx, double sy, double amplitude) {
    return Bump{cx, cy, sx, sy, amplitude};
  };
  FaceFeatures f;
  f.radius_x_mm = d.width * vary(76);
  f.radius_y_mm = d.height * vary(102);
  f.radius_z_mm = d.depth * vary(85);
  const double nose = d.nose * vary(1.0), tip_y = vary(19);
  f.bridge = feature(0, vary(-2), vary(9), vary(24), 11 * nose);
  f.tip = feature(0, tip_y, vary(11), vary(11), 15 * nose);
  f.wing = feature(vary(13), tip_y + 3, vary(7), vary(7), 6 * nose);
  f.socket = feature(vary(31), vary(-20), vary(17), vary(12), vary(-10));
  f.lid = feature(vary(31), vary(-19), vary(10), vary(8), vary(5));  // over the eye
  f.brow = feature(0, vary(-38), vary(52), vary(11), d.brow * vary(4.5));
  f.cheekbone = feature(vary(43), vary(12), vary(22), vary(19), d.cheekbones * vary(6));
  f.upper_lip = feature(0, vary(43), vary(22), vary(5), d.lips * vary(4.5));
  f.lower_lip = feature(0, vary(53), vary(18), vary(6), d.lips * vary(5));
  f.chin_fold = feature(0, vary(63), vary(22), vary(6), vary(-3.5));
  f.chin = feature(0, vary(79), vary(19), vary(14), d.chin * vary(9));
  return f;
}

std::vector<Bump> FaceFeatures::Bumps() const {
  return {bridge,        tip,  wing,      Mirrored(wing),      socket,    Mirrored(socket), lid,
          Mirrored(lid), brow, cheekbone, Mirrored(cheekbone), upper_lip, lower_lip,        chin_fold,
          chin};
}

}  // namespace stratalux::rig
