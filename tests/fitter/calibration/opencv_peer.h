// SPDX-License-Identifier: Apache-2.0
// The usual pipeline for a projector and a camera beside ours, on the same corners: OpenCV's calibrateCamera for each
// device, then stereoCalibrate for each pair of camera and projector.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "fitter/calibration/bundle_adjustment.h"
#include "fitter/calibration/observations.h"
#include "fitter/calibration/rig_geometry.h"

namespace stratalux::fit {

struct OpenCvDevice {
  cv::Size size;
  cv::Mat matrix, distortion;
};
// `turn`, `shift`: of stereoCalibrate, projector from camera.
[[nodiscard]] RigGeometry RigFromOpenCv(const OpenCvDevice& camera, const OpenCvDevice& projector, const cv::Mat& turn,
                                        const cv::Mat& shift);

// A calibration of each projector with the camera: rigs of one projector, in order.
using CalibratePairs = std::function<Result<std::vector<RigGeometry>>(const CalibrationObservations&)>;

// Ours: all projectors in one adjustment of all corners, none left out, distortion chosen by held-out poses; taken
// apart into pairs.
[[nodiscard]] Result<std::vector<RigGeometry>> CalibrateJointly(const CalibrationObservations& observations);

enum class PairIntrinsics { kFixed, kRefined };  // in stereoCalibrate
[[nodiscard]] Result<std::vector<RigGeometry>> CalibrateByOpenCv(const CalibrationObservations& observations,
                                                                 DistortionModel distortion, PairIntrinsics intrinsics);

// Each pose under a calibration of the others: reprojection errors of all pairs, added up (0 the camera, 1 projectors).
// Only the board's place is fitted, all corners alike.
[[nodiscard]] Result<DeviceErrors> HeldOutPairs(const CalibrationObservations& observations,
                                                const CalibratePairs& calibrate);

struct PeerResult {
  std::string settings;
  double held_out_px = 0.0;  // joint RMS
};
// The settings that predict held-out poses best, of all distortion models with fixed and refined intrinsics.
[[nodiscard]] PeerResult BestOfOpenCv(const CalibrationObservations& observations);

}  // namespace stratalux::fit
