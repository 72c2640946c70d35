// SPDX-License-Identifier: Apache-2.0
#include "fitter/motion/depth_flow.h"

#include <gmock/gmock.h>

#include "tests/fitter/motion/speckled_ball.h"

namespace stratalux::fit {
namespace {

RigCalibration RigOf(const SpeckledBall& ball) {
  RigCalibration rig;
  rig.camera = ball.camera();
  for (const double x : {-300.0, 280.0}) {
    ProjectorCalibration projector;
    projector.model = {.width = 800, .height = 600, .fx = 1200.0, .fy = 1200.0, .cx = 399.5, .cy = 299.5};
    projector.camera_from_projector = LookAt({x, 20.0, 60.0}, SpeckledBall::kCentre);
    rig.projectors.push_back(projector);
  }
  return rig;
}

// What the projector's codes say of the ball in that pose; noise of `sigma` columns.
DecodedMap Codes(const RigCalibration& rig, size_t p, const Rigid3& pose, double sigma) {
  const int width = rig.camera.model.width, height = rig.camera.model.height;
  const Image<float> nothing(width, height, 1, std::nanf(""));
  DecodedMap map{nothing, nothing, Image<float>(width, height, 1, static_cast<float>(sigma)), nothing,
                 Image<uint8_t>(width, height, 1, static_cast<uint8_t>(DecodeReason::kUnlit))};
  const Rigid3 projector_from_camera = rig.projectors[p].camera_from_projector.Inverse();
  Random random(p + 1, 5);
  const Eigen::Vector3d centre = pose * SpeckledBall::kCentre;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const Eigen::Vector3d ray = rig.camera.model.Unproject({double(x), double(y)}).normalized();
      const double along = ray.dot(centre);
      const double beyond = SpeckledBall::kRadiusMm * SpeckledBall::kRadiusMm - (centre.squaredNorm() - along * along);
      if (beyond <= 0.0) continue;
      const Eigen::Vector3d point = ray * (along - std::sqrt(beyond));
      const auto pixel = rig.projectors[p].model.Project(projector_from_camera * point);
      if (!pixel) continue;
      map.column(x, y) = static_cast<float>(pixel->x() + sigma * random.Normal());
      map.row(x, y) = static_cast<float>(pixel->y());
      map.reason(x, y) = static_cast<uint8_t>(DecodeReason::kValid);
    }
  return map;
}

TEST(RangesOf, AreThoseOfTheBall) {
  const SpeckledBall ball(1);
  const RigCalibration rig = RigOf(ball);
  const SurfaceMap surface = ball.Surface();
  for (const size_t p : {0, 1}) {
    const RangeMap ranges = RangesOf(Codes(rig, p, {}, 0.0), rig, p);
    int known = 0;
    for (int j = 0; j < ball.height(); ++j)
      for (int i = 0; i < ball.width(); ++i) {
        if (surface.mask(i, j) == 0 || surface.Normal(i, j).z() > -0.8 || !std::isfinite(ranges.range_mm(i, j)))
          continue;
        EXPECT_NEAR(ranges.range_mm(i, j), surface.Point(i, j).norm(), 0.05) << i << ' ' << j;
        ++known;
      }
    EXPECT_GT(known, 1500);
  }
}

TEST(DepthFlow, FindsWhatChangesDepthAndLeavesTheRestOpen) {
  const SpeckledBall ball(1);
  const RigCalibration rig = RigOf(ball);
  const SmallMotion motion{{0.0015, -0.001, 0.0}, {0.0, 0.0, 0.5}};
  const Eigen::Vector3d pivot = SpeckledBall::kCentre + Eigen::Vector3d(0.0, 0.0, 200.0);
  const auto flow = FindDepthFlow(RangesOf(Codes(rig, 0, {}, 0.05), rig, 0),
                                  RangesOf(Codes(rig, 1, motion.About(pivot), 0.05), rig, 1), ball.Surface(), pivot);
  ASSERT_TRUE(flow);
  const Eigen::Vector3d front = SpeckledBall::kCentre - Eigen::Vector3d(0.0, 0.0, SpeckledBall::kRadiusMm);
  // To the first order: a ball that slides about its own centre stays what it is, and that direction is left open.
  const auto depth_of = [&](const SmallMotion& of) { return (of.turn_rad.cross(front - pivot) + of.shift_mm).z(); };
  EXPECT_NEAR(depth_of(flow->motion), depth_of(motion), 0.02);
  EXPECT_GT(std::sqrt(flow->covariance(3, 3)), 0.3) << "sideways the whites tell";
  EXPECT_GT(std::sqrt(flow->covariance(2, 2)), 0.005);
  EXPECT_LT(std::sqrt(flow->covariance(5, 5)), 0.5);
  EXPECT_NEAR(flow->residual, 1.0, 0.25) << "of the codes' own noise";
}

TEST(DepthFlow, SaysNothingOfProjectorsThatShareNoQuads) {
  const SpeckledBall ball(2);
  const RigCalibration rig = RigOf(ball);
  RangeMap nothing{Image<float>(ball.width(), ball.height(), 1, std::nanf("")),
                   Image<float>(ball.width(), ball.height(), 1, std::nanf(""))};
  EXPECT_FALSE(FindDepthFlow(RangesOf(Codes(rig, 0, {}, 0.0), rig, 0), nothing, ball.Surface(), SpeckledBall::kCentre));
}

}  // namespace
}  // namespace stratalux::fit
