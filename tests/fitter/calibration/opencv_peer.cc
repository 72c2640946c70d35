// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/calibration/opencv_peer.h"

#include <limits>

#include <opencv2/calib3d.hpp>

#include "fitter/calibration/calibrate_rig.h"
#include "fitter/calibration/initial_rig.h"

namespace stratalux::fit {
namespace {

int FlagsOf(DistortionModel model) {
  switch (model) {
    case DistortionModel::kK1:
      return cv::CALIB_FIX_K2 | cv::CALIB_FIX_K3 | cv::CALIB_ZERO_TANGENT_DIST;
    case DistortionModel::kK1K2:
      return cv::CALIB_FIX_K3 | cv::CALIB_ZERO_TANGENT_DIST;
    case DistortionModel::kFull:
      break;
  }
  return 0;
}

struct PairCorners {
  std::vector<std::vector<cv::Point3f>> board;
  std::vector<std::vector<cv::Point2f>> seen, lit;
};

// Corners that the projector lights; all of them, for the camera alone, with `projector` < 0.
PairCorners CornersOf(const CalibrationObservations& observations, int projector) {
  constexpr size_t kLeast = 6;
  PairCorners corners;
  for (const PoseObservation& pose : observations.poses) {
    std::vector<cv::Point3f> board;
    std::vector<cv::Point2f> seen, lit;
    for (const CornerObservation& c : pose.corners) {
      const Eigen::Vector2d* there = c.SeenBy(static_cast<size_t>(projector + 1));
      if (there == nullptr) continue;
      const Eigen::Vector2f mm = observations.board.CornerMm(c.corner).cast<float>();
      board.emplace_back(mm.x(), mm.y(), 0.0F);
      seen.emplace_back(static_cast<float>(c.camera_px.x()), static_cast<float>(c.camera_px.y()));
      lit.emplace_back(static_cast<float>(there->x()), static_cast<float>(there->y()));
    }
    if (board.size() < kLeast) continue;
    corners.board.push_back(std::move(board));
    corners.seen.push_back(std::move(seen));
    corners.lit.push_back(std::move(lit));
  }
  return corners;
}

OpenCvDevice Alone(const PairCorners& corners, const std::vector<std::vector<cv::Point2f>>& pixels, DeviceSize size,
                   int flags) {
  OpenCvDevice device{{size.width, size.height}, {}, {}};
  std::vector<cv::Mat> turns, shifts;
  cv::calibrateCamera(corners.board, pixels, device.size, device.matrix, device.distortion, turns, shifts, flags);
  return device;
}

Pinhole PinholeFrom(const OpenCvDevice& d) {
  Pinhole p{d.size.width,
            d.size.height,
            d.matrix.at<double>(0, 0),
            d.matrix.at<double>(1, 1),
            d.matrix.at<double>(0, 2),
            d.matrix.at<double>(1, 2),
            {}};
  for (int i = 0; i < 5; ++i) p.distortion[static_cast<size_t>(i)] = d.distortion.at<double>(i);
  return p;
}

CalibrationObservations PairOf(const CalibrationObservations& observations, size_t projector) {
  CalibrationObservations pair = observations;
  pair.projectors = {observations.projectors[projector]};
  for (PoseObservation& pose : pair.poses)
    for (CornerObservation& c : pose.corners) c.projector_px = {std::optional(c.projector_px[projector])};
  for (PoseObservation& pose : pair.poses)
    std::erase_if(pose.corners, [](const CornerObservation& c) { return c.SeenBy(1) == nullptr; });
  return pair;
}

}  // namespace

RigGeometry RigFromOpenCv(const OpenCvDevice& camera, const OpenCvDevice& projector, const cv::Mat& turn,
                          const cv::Mat& shift) {
  Rigid3 projector_from_camera;
  Eigen::Matrix3d rotation;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) rotation(i, j) = turn.at<double>(i, j);
  projector_from_camera.rotation = Eigen::Quaterniond(rotation);
  projector_from_camera.translation_mm = {shift.at<double>(0), shift.at<double>(1), shift.at<double>(2)};
  return {PinholeFrom(camera), {{PinholeFrom(projector), projector_from_camera.Inverse()}}};
}

Result<std::vector<RigGeometry>> CalibrateJointly(const CalibrationObservations& observations,
                                                  DistortionModel distortion) {
  SLX_ASSIGN_OR_RETURN(const Bundle start, StartBundle(observations, std::nullopt));
  BundleOptions options;
  options.distortion = distortion;
  SLX_ASSIGN_OR_RETURN(const BundleReport adjusted, AdjustBundle(observations, start, options));
  std::vector<RigGeometry> pairs;
  for (const ProjectorGeometry& projector : adjusted.bundle.rig.projectors)
    pairs.push_back({adjusted.bundle.rig.camera, {projector}});
  return pairs;
}

Result<std::vector<RigGeometry>> CalibrateByOpenCv(const CalibrationObservations& observations,
                                                   const PeerSettings& settings) {
  const int flags = FlagsOf(settings.distortion);
  std::vector<RigGeometry> pairs;
  try {
    const PairCorners all = CornersOf(observations, -1);
    const OpenCvDevice camera_alone = Alone(all, all.seen, observations.camera, flags);
    for (size_t p = 0; p < observations.projectors.size(); ++p) {
      const PairCorners corners = CornersOf(observations, static_cast<int>(p));
      OpenCvDevice camera{camera_alone.size, camera_alone.matrix.clone(), camera_alone.distortion.clone()};
      OpenCvDevice projector = Alone(corners, corners.lit, observations.projectors[p], flags);
      cv::Mat turn, shift, essential, fundamental;
      cv::stereoCalibrate(corners.board, corners.seen, corners.lit, camera.matrix, camera.distortion, projector.matrix,
                          projector.distortion, camera.size, turn, shift, essential, fundamental,
                          settings.intrinsics == PairIntrinsics::kFixed ? cv::CALIB_FIX_INTRINSIC
                                                                        : cv::CALIB_USE_INTRINSIC_GUESS | flags,
                          cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 100, 1e-8));
      pairs.push_back(RigFromOpenCv(camera, projector, turn, shift));
    }
  } catch (const cv::Exception& error) {
    return Status::Failed("OpenCV: " + error.err);
  }
  return pairs;
}

Result<DeviceErrors> HeldOutPairs(const CalibrationObservations& observations, const CalibratePairs& calibrate) {
  DeviceErrors total(2);
  for (size_t held = 0; held < observations.poses.size(); ++held) {
    CalibrationObservations others = observations;
    others.poses.erase(others.poses.begin() + static_cast<std::ptrdiff_t>(held));
    SLX_ASSIGN_OR_RETURN(const auto pairs, calibrate(others));
    for (size_t p = 0; p < pairs.size(); ++p) {
      const PoseObservation pose = PairOf(observations, p).poses[held];
      if (pose.corners.size() < 6) continue;
      const auto fitted = FitPose(pairs[p], {1.0, 1.0}, observations.board, pose);
      if (!fitted) return Status::Failed(pose.name + " has no place under a calibration of the others");
      total.Add(fitted->errors);
    }
  }
  return total;
}

double HeldOutOfOurs(const CalibrationObservations& observations) {
  const auto report = CalibrateRig(observations, {.reject_sigmas = 1e6});
  if (!report.ok()) return std::numeric_limits<double>::quiet_NaN();
  const auto errors = HeldOutPairs(observations, [&](const CalibrationObservations& others) {
    return CalibrateJointly(others, report->distortion);
  });
  return errors.ok() ? errors->JointRms() : std::numeric_limits<double>::quiet_NaN();
}

std::string ToString(const PeerSettings& settings) {
  return std::string(ToString(settings.distortion)) +
         (settings.intrinsics == PairIntrinsics::kFixed ? ", fixed" : ", refined");
}

double HeldOutOfOpenCv(const CalibrationObservations& observations, const PeerSettings& settings) {
  const auto errors = HeldOutPairs(
      observations, [&](const CalibrationObservations& others) { return CalibrateByOpenCv(others, settings); });
  return errors.ok() ? errors->JointRms() : std::numeric_limits<double>::quiet_NaN();
}

PeerResult BestOfOpenCv(const CalibrationObservations& observations) {
  PeerResult best{"", std::numeric_limits<double>::infinity()};
  for (const PeerSettings& settings : kPeerSettings) {
    const double held_out_px = HeldOutOfOpenCv(observations, settings);
    if (held_out_px < best.held_out_px) best = {ToString(settings), held_out_px};
  }
  return best;
}

}  // namespace stratalux::fit
