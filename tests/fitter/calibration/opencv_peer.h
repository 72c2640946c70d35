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

// Ours: all projectors in one adjustment of all corners, none left out; taken apart into pairs.
[[nodiscard]] Result<std::vector<RigGeometry>> CalibrateJointly(const CalibrationObservations& observations,
                                                                DistortionModel distortion);

enum class PairIntrinsics { kFixed, kRefined };  // in stereoCalibrate
struct PeerSettings {
  DistortionModel distortion;
  PairIntrinsics intrinsics;
};
[[nodiscard]] Result<std::vector<RigGeometry>> CalibrateByOpenCv(const CalibrationObservations& observations,
                                                                 const PeerSettings& settings);

// Each pose under a calibration of the others: reprojection errors of all pairs, added up (0 the camera, 1 projectors).
// Only the board's place is fitted, all corners alike.
[[nodiscard]] Result<DeviceErrors> HeldOutPairs(const CalibrationObservations& observations,
                                                const CalibratePairs& calibrate);

// Joint RMS of held-out poses, with the distortion model that CalibrateRig chooses on all of them; NaN: no calibration.
[[nodiscard]] double HeldOutOfOurs(const CalibrationObservations& observations);

inline constexpr PeerSettings kPeerSettings[] = {
    {DistortionModel::kK1, PairIntrinsics::kFixed},   {DistortionModel::kK1, PairIntrinsics::kRefined},
    {DistortionModel::kK1K2, PairIntrinsics::kFixed}, {DistortionModel::kK1K2, PairIntrinsics::kRefined},
    {DistortionModel::kFull, PairIntrinsics::kFixed}, {DistortionModel::kFull, PairIntrinsics::kRefined}};
[[nodiscard]] std::string ToString(const PeerSettings& settings);
// As HeldOutOfOurs.
[[nodiscard]] double HeldOutOfOpenCv(const CalibrationObservations& observations, const PeerSettings& settings);

struct PeerResult {
  std::string settings;
  double held_out_px = 0.0;  // joint RMS
};
// The settings that predict held-out poses best, of kPeerSettings.
[[nodiscard]] PeerResult BestOfOpenCv(const CalibrationObservations& observations);

}  // namespace stratalux::fit
