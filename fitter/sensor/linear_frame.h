// SPDX-License-Identifier: Apache-2.0
// The one place where raw frames become linear: the camera's response undone, its vignetting divided out. All stages
// work on what comes out of here.
#pragma once

#include <cstdint>
#include <vector>

#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// The rig whose camera would have made the linear frames.
[[nodiscard]] RigCalibration LinearRig(const RigCalibration& record);

class FrameLineariser {
 public:
  // A camera that is linear and without vignetting needs none: Apply then leaves frames as they are.
  explicit FrameLineariser(const CameraCalibration& camera);

  // The camera that would have made the linear frames: response and vignetting gone, saturation above all that is not
  // saturated, as far as 16 bits go.
  [[nodiscard]] const CameraCalibration& linear_camera() const { return linear_; }
  // Raw mosaic to linear, black level kept; saturated sites, and those whose light 16 bits do not hold, read 65535.
  // (crop_x, crop_y) is the place of the frame's first site on the sensor.
  void Apply(Image<uint16_t>& frame, int crop_x, int crop_y) const;

 private:
  static constexpr uint16_t kSaturated = 65535;

  CameraCalibration camera_, linear_;
  std::vector<float> linear_dn_;  // above black, by raw level below saturation; empty: nothing to do
  Image<float> gain_;             // 1 / vignetting, by site of the sensor; empty: 1
};

}  // namespace stratalux::fit
