// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/initial_rig.h"

#include <algorithm>
#include <limits>

#include <opencv2/calib3d.hpp>

namespace stratalux::fit {
namespace {

constexpr int kCamera = -1;

struct DeviceView {
  std::vector<size_t> poses;  // indices into the observations
  std::vector<std::vector<cv::Point3f>> board;
  std::vector<std::vector<cv::Point2f>> pixels;
};

cv::Point3f OnBoard(const BoardDescription& board, int corner) {
  const Eigen::Vector2d mm = board.CornerMm(corner);
  return {static_cast<float>(mm.x()), static_cast<float>(mm.y()), 0.0F};
}

// `device`: a projector, or kCamera.
DeviceView ViewOf(const CalibrationObservations& observations, int device) {
  DeviceView view;
  for (size_t k = 0; k < observations.poses.size(); ++k) {
    std::vector<cv::Point3f> board;
    std::vector<cv::Point2f> pixels;
    for (const CornerObservation& corner : observations.poses[k].corners) {
      const auto seen = device == kCamera ? std::optional(corner.camera_px) : corner.projector_px[device];
      if (!seen) continue;
      board.push_back(OnBoard(observations.board, corner.corner));
      pixels.emplace_back(static_cast<float>(seen->x()), static_cast<float>(seen->y()));
    }
    if (board.size() < size_t{kLeastCorners}) continue;
    view.poses.push_back(k);
    view.board.push_back(std::move(board));
    view.pixels.push_back(std::move(pixels));
  }
  return view;
}

cv::Mat MatrixOf(const Pinhole& m) { return (cv::Mat_<double>(3, 3) << m.fx, 0, m.cx, 0, m.fy, m.cy, 0, 0, 1); }

cv::Mat DistortionOf(const Pinhole& m) {
  const auto& d = m.distortion;
  return (cv::Mat_<double>(1, 5) << d[0], d[1], d[2], d[3], d[4]);
}

Rigid3 RigidFrom(const cv::Mat& turn, const cv::Mat& shift) {
  const Eigen::Vector3d w(turn.at<double>(0), turn.at<double>(1), turn.at<double>(2));
  Rigid3 pose;
  if (w.norm() > 0.0) pose.rotation = Eigen::AngleAxisd(w.norm(), w.normalized());
  pose.translation_mm = {shift.at<double>(0), shift.at<double>(1), shift.at<double>(2)};
  return pose;
}

// Intrinsics (unless known) and a board's pose for each pose of the view.
struct DeviceStart {
  Pinhole model;
  std::vector<std::optional<Rigid3>> device_from_board;
};

Result<DeviceStart> StartDevice(const CalibrationObservations& observations, int device, const DeviceSize& size,
                                const std::optional<Pinhole>& known) {
  const std::string name = device == kCamera ? "the camera" : "projector " + std::to_string(device);
  const DeviceView view = ViewOf(observations, device);
  if (view.poses.size() < 3)
    return Status::Failed(name + " sees the board in " + std::to_string(view.poses.size()) +
                          " poses; at least 3 are needed, 12 are advised");
  DeviceStart start{known.value_or(Pinhole{size.width, size.height}), {}};
  start.device_from_board.resize(observations.poses.size());
  cv::Mat matrix = known ? MatrixOf(*known) : cv::Mat::eye(3, 3, CV_64F);
  cv::Mat distortion = known ? DistortionOf(*known) : cv::Mat::zeros(1, 5, CV_64F);
  int flags = cv::CALIB_FIX_K2 | cv::CALIB_FIX_K3 | cv::CALIB_ZERO_TANGENT_DIST;
  if (known)
    flags = cv::CALIB_USE_INTRINSIC_GUESS | cv::CALIB_FIX_INTRINSIC | cv::CALIB_FIX_FOCAL_LENGTH |
            cv::CALIB_FIX_PRINCIPAL_POINT | cv::CALIB_FIX_K1 | cv::CALIB_FIX_K2 | cv::CALIB_FIX_K3 |
            cv::CALIB_FIX_TANGENT_DIST;
  std::vector<cv::Mat> turns, shifts;
  try {
    cv::calibrateCamera(view.board, view.pixels, cv::Size(size.width, size.height), matrix, distortion, turns, shifts,
                        flags);
  } catch (const cv::Exception& error) {
    return Status::Failed("no first calibration of " + name + " (" + error.err + "); capture more poses, tilted in " +
                          "different ways");
  }
  if (!known) {
    start.model.fx = matrix.at<double>(0, 0);
    start.model.fy = matrix.at<double>(1, 1);
    start.model.cx = matrix.at<double>(0, 2);
    start.model.cy = matrix.at<double>(1, 2);
    start.model.distortion[0] = distortion.at<double>(0);
    if (const Status status = start.model.Validate(); !status.ok())
      return Status::Failed("no first calibration of " + name + ": " + status.message());
  }
  for (size_t i = 0; i < view.poses.size(); ++i)
    start.device_from_board[view.poses[i]] = RigidFrom(turns[i], shifts[i]);
  return start;
}

// Where a projector stands in the camera's frame, by each pose that both see.
using Places = std::vector<std::optional<Eigen::Vector3d>>;

Places PlacesOf(const DeviceStart& camera, const DeviceStart& projector) {
  Places places(camera.device_from_board.size());
  for (size_t k = 0; k < places.size(); ++k)
    if (camera.device_from_board[k] && projector.device_from_board[k])
      places[k] = (*camera.device_from_board[k] * projector.device_from_board[k]->Inverse()).translation_mm;
  return places;
}

Eigen::Vector3d MedianPlace(const Places& places) {
  Eigen::Vector3d median;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double> values;
    for (const auto& place : places)
      if (place) values.push_back((*place)[axis]);
    std::sort(values.begin(), values.end());
    median[axis] = values[values.size() / 2];
  }
  return median;
}

// In a pose whose cables were exchanged, projector p stands where q stands in the other poses.
Status CheckNotExchanged(const CalibrationObservations& observations, const DeviceStart& camera,
                         const std::vector<DeviceStart>& projectors) {
  constexpr double kNear = 0.3;  // of the distance between the two
  std::vector<Places> places;
  std::vector<Eigen::Vector3d> medians;
  for (const DeviceStart& projector : projectors) {
    places.push_back(PlacesOf(camera, projector));
    medians.push_back(MedianPlace(places.back()));
  }
  for (size_t p = 0; p < projectors.size(); ++p)
    for (size_t q = p + 1; q < projectors.size(); ++q)
      for (size_t k = 0; k < observations.poses.size(); ++k) {
        if (!places[p][k] || !places[q][k]) continue;
        const double apart = (medians[p] - medians[q]).norm();
        if ((*places[p][k] - medians[q]).norm() > kNear * apart || (*places[q][k] - medians[p]).norm() > kNear * apart)
          continue;
        return Status::Failed(observations.poses[k].name + ": projectors " + std::to_string(p) + " and " +
                              std::to_string(q) +
                              " are exchanged: other poses show them the other way round; plug their cables in as "
                              "they were and capture this pose again");
      }
  return Status::Ok();
}

// Of the places that single poses give, the one that fits the corners of all poses best.
Rigid3 PlaceProjector(const CalibrationObservations& observations, const RigGeometry& camera_alone,
                      const DeviceStart& camera, const DeviceStart& projector, size_t p) {
  Rigid3 best;
  double least = std::numeric_limits<double>::infinity();
  for (size_t k = 0; k < observations.poses.size(); ++k) {
    if (!projector.device_from_board[k] || !camera.device_from_board[k]) continue;
    RigGeometry rig = camera_alone;
    rig.projectors[p] = {projector.model, *camera.device_from_board[k] * projector.device_from_board[k]->Inverse()};
    DeviceErrors errors(1 + rig.projectors.size());
    for (size_t j = 0; j < observations.poses.size(); ++j)
      if (camera.device_from_board[j])
        errors.Add(ReprojectionErrors(rig, observations.board, *camera.device_from_board[j], observations.poses[j]));
    if (errors.Rms(1 + p) >= least) continue;
    least = errors.Rms(1 + p);
    best = rig.projectors[p].camera_from_projector;
  }
  return best;
}

}  // namespace

Result<Bundle> StartBundle(const CalibrationObservations& observations, const std::optional<Pinhole>& known_camera) {
  SLX_ASSIGN_OR_RETURN(const DeviceStart camera, StartDevice(observations, kCamera, observations.camera, known_camera));
  Bundle bundle;
  bundle.rig.camera = camera.model;
  bundle.rig.projectors.resize(observations.projectors.size());
  for (size_t k = 0; k < observations.poses.size(); ++k) {
    if (!camera.device_from_board[k])
      return Status::Failed(observations.poses[k].name + ": fewer than " + std::to_string(kLeastCorners) +
                            " corners; capture this pose again");
    bundle.camera_from_board.push_back(*camera.device_from_board[k]);
  }
  const RigGeometry camera_alone = bundle.rig;
  std::vector<DeviceStart> projectors;
  for (size_t p = 0; p < observations.projectors.size(); ++p) {
    SLX_ASSIGN_OR_RETURN(DeviceStart projector,
                         StartDevice(observations, static_cast<int>(p), observations.projectors[p], std::nullopt));
    projectors.push_back(std::move(projector));
  }
  SLX_RETURN_IF_ERROR(CheckNotExchanged(observations, camera, projectors));
  for (size_t p = 0; p < projectors.size(); ++p)
    bundle.rig.projectors[p] = {projectors[p].model,
                                PlaceProjector(observations, camera_alone, camera, projectors[p], p)};
  return bundle;
}

std::optional<Rigid3> BoardPoseFromCamera(const Pinhole& camera, const BoardDescription& board,
                                          const PoseObservation& pose) {
  std::vector<cv::Point3f> on_board;
  std::vector<cv::Point2f> pixels;
  for (const CornerObservation& corner : pose.corners) {
    on_board.push_back(OnBoard(board, corner.corner));
    pixels.emplace_back(static_cast<float>(corner.camera_px.x()), static_cast<float>(corner.camera_px.y()));
  }
  if (on_board.size() < 4) return std::nullopt;
  cv::Mat turn, shift;
  try {
    if (!cv::solvePnP(on_board, pixels, MatrixOf(camera), DistortionOf(camera), turn, shift)) return std::nullopt;
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  return RigidFrom(turn, shift);
}

}  // namespace stratalux::fit
