// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/corner_residuals.h"

#include <memory>
#include <vector>

#include <ceres/ceres.h>
#include <ceres/gradient_checker.h>
#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "tests/fitter/calibration/synthetic_boards.h"

namespace stratalux::fit {
namespace {

// Parameters near a sensible rig, shaken.
struct Parameters {
  std::vector<double> camera{3248, 3240, 701, 517, -0.06, 0.05, 1e-3, -2e-3, 0.02};
  std::vector<double> projector{2690, 2700, 517, 374, -0.03, 0.02, -1e-3, 1e-3, 0.01};
  std::vector<double> place{0.05, 0.55, -0.02, -450, -60, 5}, board{0.3, -0.2, 0.1, -80, -50, 700};

  explicit Parameters(uint64_t seed) {
    Random random(seed);
    for (std::vector<double>* block : {&camera, &projector, &place, &board})
      for (double& v : *block) v *= 1.0 + 0.02 * random.Normal();
  }
};

void ExpectDerivatives(const ceres::CostFunction& cost, const std::vector<double*>& blocks, uint64_t seed) {
  ceres::NumericDiffOptions options;
  options.ridders_relative_initial_step_size = 1e-3;
  const ceres::GradientChecker checker(&cost, static_cast<std::vector<const ceres::Manifold*>*>(nullptr), options);
  ceres::GradientChecker::ProbeResults results;
  EXPECT_TRUE(checker.Probe(blocks.data(), 1e-6, &results)) << "seed " << seed << ": " << results.error_log;
}

TEST(CornerResiduals, DerivativesOfTheCameraAreThoseOfFiniteDifferences) {
  for (uint64_t seed = 1; seed <= 8; ++seed) {
    Parameters p(seed);
    const ceres::AutoDiffCostFunction<CameraCornerResidual, 2, 9, 6> cost(
        new CameraCornerResidual{{350, 250}, {1800, 1400}, 0.1});
    ExpectDerivatives(cost, {p.camera.data(), p.board.data()}, seed);
  }
}

TEST(CornerResiduals, DerivativesOfTheTransferAreThoseOfFiniteDifferences) {
  for (uint64_t seed = 1; seed <= 8; ++seed) {
    Parameters p(seed);
    const ceres::AutoDiffCostFunction<TransferResidual, 2, 9, 9, 6, 6> cost(
        new TransferResidual{{1900, -300}, {900, -200}, 0.1});
    ExpectDerivatives(cost, {p.camera.data(), p.projector.data(), p.place.data(), p.board.data()}, seed);
  }
}

// The functors and Pinhole are two statements of one model.
TEST(CornerResiduals, VanishForTheRigThatMadeTheCorners) {
  const RigGeometry rig = ExampleRig(1);
  const auto poses = ExamplePoses();
  const auto o = Observe(rig, poses, {0.0, 0.0}, 1);
  auto intrinsics = [](const Pinhole& m) {
    return std::vector<double>{
        m.fx, m.fy, m.cx, m.cy, m.distortion[0], m.distortion[1], m.distortion[2], m.distortion[3], m.distortion[4]};
  };
  auto pose_vector = [](const Rigid3& pose) {
    const Eigen::AngleAxisd turn(pose.rotation);
    const Eigen::Vector3d w = turn.angle() * turn.axis(), t = pose.translation_mm;
    return std::vector<double>{w.x(), w.y(), w.z(), t.x(), t.y(), t.z()};
  };
  const auto camera = intrinsics(rig.camera), projector = intrinsics(rig.projectors[0].model);
  const auto place = pose_vector(rig.projectors[0].camera_from_projector);
  for (size_t k = 0; k < poses.size(); ++k)
    for (const CornerObservation& c : o.poses[k].corners) {
      const auto board = pose_vector(poses[k]);
      double r[2] = {1.0, 1.0};
      ASSERT_TRUE((CameraCornerResidual{o.board.CornerMm(c.corner), c.camera_px}(camera.data(), board.data(), r)));
      EXPECT_LT(std::hypot(r[0], r[1]), 1e-9);
      ASSERT_TRUE((TransferResidual{c.camera_px, *c.projector_px[0]}(camera.data(), projector.data(), place.data(),
                                                                     board.data(), r)));
      EXPECT_LT(std::hypot(r[0], r[1]), 1e-6);
    }
}

}  // namespace
}  // namespace stratalux::fit
