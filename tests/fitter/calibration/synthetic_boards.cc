// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/calibration/synthetic_boards.h"

#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

// Where the projector's pixel for a camera pixel lies: through the board's plane.
std::optional<Eigen::Vector2d> Transfer(const RigGeometry& rig, size_t p, const Rigid3& board,
                                        const Eigen::Vector2d& camera_px) {
  const Eigen::Vector3d normal = board.rotation * Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d ray = rig.camera.Unproject(camera_px);
  const Eigen::Vector3d point = ray * (normal.dot(board.translation_mm) / normal.dot(ray));
  return rig.projectors[p].model.Project(rig.projectors[p].camera_from_projector.Inverse() * point);
}

}  // namespace

RigGeometry ExampleRig(int projectors) {
  const std::vector<Eigen::Vector3d> places = {{-450, -60, 0}, {430, 80, 10}, {-180, -300, 20}, {200, 300, 20}};
  RigGeometry rig{{1392, 1042, 3248, 3248, 701, 517, {-0.06, 0.05}}, {}};
  for (int p = 0; p < projectors; ++p)
    rig.projectors.push_back(
        {{1024, 768, 2690, 2690, 517.5, 374.5, {-0.03, 0.02}}, LookAt(places[static_cast<size_t>(p)], {0, 4, 700})});
  return rig;
}

std::vector<Rigid3> ExamplePoses() {
  std::vector<Rigid3> poses;
  for (int k = 0; k < 12; ++k) {
    const double around = 2.0 * M_PI * k / 12.0, tilt = RadFromDeg(k % 2 == 0 ? 25.0 : 15.0);
    Rigid3 pose;
    pose.rotation = Eigen::AngleAxisd(tilt, Eigen::Vector3d(std::cos(around), std::sin(around), 0.0)) *
                    Eigen::AngleAxisd(0.3 * k, Eigen::Vector3d::UnitZ());
    const Eigen::Vector3d middle_of_board(80, 50, 0);
    pose.translation_mm =
        Eigen::Vector3d(15 * std::cos(3 * around), 15 * std::sin(2 * around), 700 + 40 * std::cos(around + 1)) -
        pose.rotation * middle_of_board;
    poses.push_back(pose);
  }
  return poses;
}

CalibrationObservations Observe(const RigGeometry& rig, const std::vector<Rigid3>& camera_from_board,
                                const BoardNoise& noise, uint64_t seed) {
  CalibrationObservations o;
  o.board = {BoardKind::kChess, 10, 7, 20.0, 15.0};
  o.camera = {rig.camera.width, rig.camera.height};
  for (const ProjectorGeometry& p : rig.projectors) o.projectors.push_back({p.model.width, p.model.height});
  Random random(seed);
  auto shaken = [&](const Eigen::Vector2d& pixel, double sigma) {
    return Eigen::Vector2d(pixel.x() + sigma * random.Normal(), pixel.y() + sigma * random.Normal());
  };
  for (size_t k = 0; k < camera_from_board.size(); ++k) {
    PoseObservation pose{static_cast<int>(k), "pose " + std::to_string(k), {}};
    for (int c = 0; c < o.board.corners(); ++c) {
      const Eigen::Vector2d mm = o.board.CornerMm(c);
      const auto seen = rig.camera.Project(camera_from_board[k] * Eigen::Vector3d(mm.x(), mm.y(), 0.0));
      if (!seen || !rig.camera.Contains(*seen)) continue;
      CornerObservation corner{c, shaken(*seen, noise.corner_px), {}};
      for (size_t p = 0; p < rig.projectors.size(); ++p) {
        const auto lit = Transfer(rig, p, camera_from_board[k], corner.camera_px);
        corner.projector_px.push_back(lit ? std::optional(shaken(*lit, noise.lookup_px)) : std::nullopt);
      }
      pose.corners.push_back(corner);
    }
    o.poses.push_back(pose);
  }
  return o;
}

}  // namespace stratalux::fit
