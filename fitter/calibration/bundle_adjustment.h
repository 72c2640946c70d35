// SPDX-License-Identifier: Apache-2.0
// ONE adjustment of camera, all projectors and all board poses over all corners (docs/math/calibration.md).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "fitter/calibration/observations.h"
#include "fitter/calibration/rig_geometry.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// Which of k1 k2 p1 p2 k3 are free; the others stay 0.
enum class DistortionModel { kK1, kK1K2, kFull };
[[nodiscard]] const char* ToString(DistortionModel model);
[[nodiscard]] Result<DistortionModel> ParseDistortionModel(const std::string& text);

// A device's parameters in the order of its covariance: fx fy cx cy k1 k2 p1 p2 k3, and for projectors the angle-axis
// (rad) and translation (mm) of camera_from_projector.
inline constexpr int kIntrinsics = 9, kPoseParameters = 6;
[[nodiscard]] const char* ParameterName(int index);

enum class Known { kNothing, kCameraIntrinsics, kWholeRig };  // what stays as it starts

struct BundleOptions {
  DistortionModel distortion = DistortionModel::kK1K2;  // of the devices that are not known
  Known known = Known::kNothing;
  double outlier_sigmas = 3.0;  // Huber's corner
  // Standard deviations by device (0 camera, 1 + p projector p), px; empty: estimated from the residuals.
  std::vector<double> sigma_px{};
};

struct Bundle {
  RigGeometry rig;
  std::vector<Rigid3> camera_from_board;  // by pose
};

struct BundleReport {
  Bundle bundle;
  std::vector<double> sigma_px;  // camera: of a corner; projectors: of the transfer through the board's plane
  int iterations = 0;
  double cost = 0.0;
};

// `start` holds a pose for each of the observations'. kFailed names what went wrong. Reentrant.
[[nodiscard]] Result<BundleReport> AdjustBundle(const CalibrationObservations& observations, const Bundle& start,
                                                const BundleOptions& options);

// Covariance of each device's parameters (9 x 9 the camera's, 15 x 15 a projector's) in the order of ParameterName.
// Rows of fixed parameters are 0. kFailed: the observations do not determine the parameters.
[[nodiscard]] Result<std::vector<Eigen::MatrixXd>> DeviceCovariances(const CalibrationObservations& observations,
                                                                     const BundleReport& adjusted,
                                                                     const BundleOptions& options);

}  // namespace stratalux::fit
