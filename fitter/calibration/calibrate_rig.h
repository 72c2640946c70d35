// SPDX-License-Identifier: Apache-2.0
// Geometric calibration of a rig: choice of the distortion model by held-out poses, one bundle adjustment, and what can
// be said of its trustworthiness (docs/calibration.md explains each figure).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "fitter/calibration/bundle_adjustment.h"
#include "fitter/calibration/observations.h"
#include "fitter/calibration/rig_geometry.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct CalibrateOptions {
  std::optional<Pinhole> known_camera{};        // intrinsics that stay; of the observations' picture size
  std::optional<DistortionModel> distortion{};  // unset: chosen by the held-out error
  // Of the models whose held-out error exceeds the least by no more than this share, the richest.
  double richer_within = 0.01;
  // A corner is left out whose residual in any device exceeds so many standard deviations.
  double reject_sigmas = 6.0;
  [[nodiscard]] Status Validate() const;
};

struct HeldOutPose {
  std::string name;
  DeviceErrors errors;    // of the pose under a calibration without it; only the board's place is fitted
  double surprise = 0.0;  // its residuals in standard deviations, root mean square (Huber's above 3)
};

struct ModelTrial {
  DistortionModel model = DistortionModel::kK1K2;
  // Root mean square of `surprise` over the held-out poses, which decides; infinity where a fit failed. It weighs the
  // transfer from camera to projector, which knows nothing of how well corners were found, as it deserves.
  double held_out_sigmas = 0.0;
  double held_out_px = 0.0;  // joint RMS
};

struct RejectedCorner {
  std::string pose;
  int corner = 0;
  double sigmas = 0.0;
};

struct GeometryReport {
  Bundle bundle;
  DistortionModel distortion = DistortionModel::kK1K2;
  std::vector<ModelTrial> trials;
  std::vector<double> sigma_px;              // by device: 0 camera, 1 + p projector p
  std::vector<Eigen::MatrixXd> covariances;  // by device (DeviceCovariances); empty: not determined
  std::vector<DeviceErrors> training;        // by pose
  DeviceErrors training_total, epipolar;
  std::vector<HeldOutPose> held_out;
  DeviceErrors held_out_total;
  std::vector<RejectedCorner> rejected;
  std::vector<std::string> left_out;  // poses of which rejection left fewer than kLeastCorners: name, cause, remedy
  int corners = 0;                    // that were used, in the camera, over all poses
  // Share of the picture that corners cover, by device: cells of an 8 x 6 grid with at least one corner.
  std::vector<double> coverage;
  std::vector<std::vector<int>> coverage_map;  // corners in each of the 48 cells, row by row
  std::vector<double> tilt_deg;                // by pose: of the board's normal against the camera's axis
  CalibrationObservations used;                // without what was rejected
};

inline constexpr int kCoverageColumns = 8, kCoverageRows = 6;

// kUsage for options, and a known camera of another size; kFailed names the device or pose in the way. Reentrant; the
// same bits each time.
[[nodiscard]] Result<GeometryReport> CalibrateRig(const CalibrationObservations& observations,
                                                  const CalibrateOptions& options = {});

// A pose under a given rig, only the board's place fitted; nullopt where no place fits.
[[nodiscard]] std::optional<HeldOutPose> FitPose(const RigGeometry& rig, const std::vector<double>& sigma_px,
                                                 const BoardDescription& board, const PoseObservation& pose);

}  // namespace stratalux::fit
