// SPDX-License-Identifier: Apache-2.0
#include "fitter/sensor/linear_frame.h"

#include <algorithm>
#include <cmath>

#include "shared/base/parallel.h"

namespace stratalux::fit {

FrameLineariser::FrameLineariser(const CameraCalibration& camera) : camera_(camera), linear_(camera) {
  const bool vignetted = camera.vignetting != std::array<double, 2>{};
  if (camera.response.empty() && !vignetted) return;
  linear_.response.clear();
  linear_.vignetting = {};
  for (int raw = 0; raw < std::min(65536.0, camera.saturation_dn); ++raw)
    linear_dn_.push_back(static_cast<float>(camera.LinearDn(raw - camera.black_level_dn)));
  float most = 1.0F;
  if (vignetted) {
    gain_ = Image<float>(camera.model.width, camera.model.height);
    for (int y = 0; y < gain_.height(); ++y)
      for (int x = 0; x < gain_.width(); ++x) {
        gain_(x, y) = static_cast<float>(1.0 / camera.Vignetting(x, y));
        most = std::max(most, gain_(x, y));
      }
  }
  linear_.saturation_dn = std::min(
      65535.0,
      std::ceil(camera.black_level_dn + camera.LinearDn(camera.saturation_dn - camera.black_level_dn) * most) + 1.0);
}

RigCalibration LinearRig(const RigCalibration& record) {
  RigCalibration rig = record;
  rig.camera = FrameLineariser(record.camera).linear_camera();
  return rig;
}

void FrameLineariser::Apply(Image<uint16_t>& frame, int crop_x, int crop_y) const {
  if (linear_dn_.empty()) return;
  ParallelFor(frame.height(), 32, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < frame.width(); ++x) {
        uint16_t& level = frame(x, y);
        if (level >= linear_dn_.size()) {
          level = kSaturated;
          continue;
        }
        float light = linear_dn_[level];
        if (gain_.contains(x + crop_x, y + crop_y)) light *= gain_(x + crop_x, y + crop_y);
        // What 16 bits do not hold is as good as saturated, not a little less bright than it was.
        const float dn = static_cast<float>(camera_.black_level_dn) + light + 0.5F;
        level = static_cast<uint16_t>(std::clamp(dn, 0.0F, static_cast<float>(kSaturated)));
      }
  });
}

}  // namespace stratalux::fit
