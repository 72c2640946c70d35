// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/rig_geometry.h"

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <numeric>

namespace stratalux::fit {
namespace {

constexpr double kNowherePx = 1e4;  // error of a corner that the device cannot see at all

double SquaredError(const std::optional<Eigen::Vector2d>& projected, const Eigen::Vector2d& seen) {
  return projected ? (*projected - seen).squaredNorm() : kNowherePx * kNowherePx;
}

}  // namespace

RigGeometry RigGeometry::From(const RigCalibration& calibration) {
  RigGeometry rig{calibration.camera.model, {}};
  for (const ProjectorCalibration& p : calibration.projectors)
    rig.projectors.push_back({p.model, p.camera_from_projector});
  return rig;
}

std::string DeviceName(size_t device) { return device == 0 ? "camera" : "projector " + std::to_string(device - 1); }

std::vector<double> DeviceParameters(const RigGeometry& rig, size_t device) {
  const Pinhole& m = device == 0 ? rig.camera : rig.projectors[device - 1].model;
  std::vector<double> values{m.fx, m.fy, m.cx, m.cy};
  values.insert(values.end(), m.distortion.begin(), m.distortion.end());
  if (device == 0) return values;
  const Rigid3& pose = rig.projectors[device - 1].camera_from_projector;
  const Eigen::AngleAxisd turn(pose.rotation);
  const Eigen::Vector3d w = turn.angle() * turn.axis();
  values.insert(values.end(), {w.x(), w.y(), w.z()});
  values.insert(values.end(), {pose.translation_mm.x(), pose.translation_mm.y(), pose.translation_mm.z()});
  return values;
}

void DeviceErrors::Add(const DeviceErrors& other) {
  for (size_t d = 0; d < squares.size(); ++d) {
    squares[d] += other.squares[d];
    counts[d] += other.counts[d];
  }
}

double DeviceErrors::Rms(size_t device) const {
  return counts[device] > 0 ? std::sqrt(squares[device] / counts[device]) : std::numeric_limits<double>::quiet_NaN();
}

double DeviceErrors::JointRms() const {
  const int count = std::accumulate(counts.begin(), counts.end(), 0);
  const double sum = std::accumulate(squares.begin(), squares.end(), 0.0);
  return count > 0 ? std::sqrt(sum / count) : std::numeric_limits<double>::quiet_NaN();
}

std::optional<Eigen::Vector2d> ProjectCorner(const RigGeometry& rig, size_t device, const BoardDescription& board,
                                             const Rigid3& camera_from_board, int corner) {
  const Eigen::Vector2d on_board = board.CornerMm(corner);
  const Eigen::Vector3d x_in_camera = camera_from_board * Eigen::Vector3d(on_board.x(), on_board.y(), 0.0);
  if (device == 0) return rig.camera.Project(x_in_camera);
  const ProjectorGeometry& projector = rig.projectors[device - 1];
  return projector.model.Project(projector.camera_from_projector.Inverse() * x_in_camera);
}

DeviceErrors ReprojectionErrors(const RigGeometry& rig, const BoardDescription& board, const Rigid3& camera_from_board,
                                const PoseObservation& pose) {
  DeviceErrors errors(1 + rig.projectors.size());
  for (const CornerObservation& corner : pose.corners)
    for (size_t d = 0; d <= rig.projectors.size(); ++d) {
      const Eigen::Vector2d* seen = corner.SeenBy(d);
      if (seen == nullptr) continue;
      errors.squares[d] += SquaredError(ProjectCorner(rig, d, board, camera_from_board, corner.corner), *seen);
      ++errors.counts[d];
    }
  return errors;
}

DeviceErrors EpipolarErrors(const RigGeometry& rig, const PoseObservation& pose) {
  DeviceErrors errors(1 + rig.projectors.size());
  for (const CornerObservation& corner : pose.corners)
    for (size_t p = 0; p < rig.projectors.size(); ++p) {
      if (!corner.projector_px[p]) continue;
      const ProjectorGeometry& projector = rig.projectors[p];
      const Rigid3 projector_from_camera = projector.camera_from_projector.Inverse();
      const Eigen::Vector3d ray = projector_from_camera.rotation * rig.camera.Unproject(corner.camera_px);
      const Eigen::Vector3d line = projector_from_camera.translation_mm.cross(ray);  // of x' in line . x' = 0
      const Eigen::Vector3d seen = projector.model.Unproject(*corner.projector_px[p]);
      const double distance = line.dot(seen / seen.z()) / line.head<2>().norm();
      const double focal_px = 0.5 * (projector.model.fx + projector.model.fy);
      errors.squares[1 + p] += focal_px * distance * focal_px * distance;
      ++errors.counts[1 + p];
    }
  return errors;
}

}  // namespace stratalux::fit
