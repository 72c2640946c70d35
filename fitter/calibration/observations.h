// SPDX-License-Identifier: Apache-2.0
// What geometric calibration starts from: where each device sees each corner of the board, pose by pose.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "fitter/calibration/board.h"

namespace stratalux::fit {

struct CornerObservation {
  int corner = 0;             // BoardDescription::CornerMm
  Eigen::Vector2d camera_px;  // full-frame mosaic pixels
  // (column, row) in each projector that lights `camera_px`, looked up there; nullopt where it could not be.
  std::vector<std::optional<Eigen::Vector2d>> projector_px;

  // Device 0 is the camera, 1 + p projector p; null where it does not see the corner.
  [[nodiscard]] const Eigen::Vector2d* SeenBy(size_t device) const {
    if (device == 0) return &camera_px;
    return projector_px[device - 1] ? &*projector_px[device - 1] : nullptr;
  }
};

struct PoseObservation {
  int pose = -1;     // number as captured; -1: none
  std::string name;  // of pose or session, for messages; such as "pose 3 (session s000012)"
  std::vector<CornerObservation> corners;
};

struct DeviceSize {
  int width = 0, height = 0;  // px
};

struct CalibrationObservations {
  BoardDescription board;
  DeviceSize camera;
  std::vector<DeviceSize> projectors;
  std::vector<PoseObservation> poses;
};

}  // namespace stratalux::fit
