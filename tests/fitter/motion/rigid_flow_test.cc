// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>

#include "tests/fitter/motion/speckled_ball.h"

namespace stratalux::fit {
namespace {

// Root mean square distance between two poses over the ball's quads.
double Apart(const SurfaceMap& surface, const Rigid3& a, const Rigid3& b) {
  double sum = 0.0;
  int quads = 0;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      if (surface.mask(i, j) != 0) {
        sum += (a * surface.Point(i, j) - b * surface.Point(i, j)).squaredNorm();
        ++quads;
      }
  return std::sqrt(sum / quads);
}

SmallMotion Random6(uint64_t seed, double shift_mm, double turn_rad) {
  Random random(seed, 11);
  SmallMotion motion;
  for (int k = 0; k < 3; ++k) {
    motion.shift_mm[k] = shift_mm * random.Normal();
    motion.turn_rad[k] = turn_rad * random.Normal();
  }
  return motion;
}

std::optional<RigidFlow> FindRigidFlow(const Image<float>& from, const Image<float>& to, const Image<uint8_t>& lit,
                                       const SurfaceMap& surface, const CameraCalibration& camera,
                                       const Eigen::Vector3d& light_mm, const Eigen::Vector3d& pivot) {
  return FindRigidFlows(from, std::span(&to, 1), lit, surface, camera, light_mm, pivot).front();
}

TEST(RigidFlow, FindsTheMotionUnderAFixedLightFromDifferentHeads) {
  for (const uint64_t seed : {1, 2, 3}) {
    const SpeckledBall ball(seed);
    const SurfaceMap surface = ball.Surface();
    const Eigen::Vector3d pivot(5.0, -8.0, 650.0);
    const SmallMotion truth = Random6(seed, 0.6, 0.005);
    const auto flow = FindRigidFlow(ball.Picture({}, 0.005, seed), ball.Picture(truth.About(pivot), 0.005, seed + 100),
                                    ball.Lit(), surface, ball.camera(), SpeckledBall::kLight, pivot);
    ASSERT_TRUE(flow) << seed;
    EXPECT_LT(Apart(surface, flow->motion.About(pivot), truth.About(pivot)), 0.05)
        << seed << ": found " << flow->motion.Vector().transpose() << ", true " << truth.Vector().transpose();
    EXPECT_GT(Apart(surface, {}, truth.About(pivot)), 0.3);
  }
}

// Each as if it were the only one, and one that shows nothing takes nothing from those after it.
TEST(RigidFlow, FindsEachOfSeveralLaterPictures) {
  const SpeckledBall ball(4);
  const SurfaceMap surface = ball.Surface();
  const Eigen::Vector3d pivot = SpeckledBall::kCentre;
  const Image<float> first = ball.Picture({}, 0.005, 9);
  std::vector<Image<float>> later;
  for (const uint64_t k : {1, 2, 3}) later.push_back(ball.Picture(Random6(k, 0.6, 0.005).About(pivot), 0.005, k));
  later.insert(later.begin() + 1, Image<float>(ball.width(), ball.height(), 1, std::nanf("")));
  const auto flows = FindRigidFlows(first, later, ball.Lit(), surface, ball.camera(), SpeckledBall::kLight, pivot);
  ASSERT_EQ(flows.size(), later.size());
  EXPECT_FALSE(flows[1]);
  for (const size_t k : {0, 2, 3}) {
    const auto alone = FindRigidFlow(first, later[k], ball.Lit(), surface, ball.camera(), SpeckledBall::kLight, pivot);
    ASSERT_TRUE(flows[k] && alone) << k;
    EXPECT_LT(Apart(surface, flows[k]->motion.About(pivot), alone->motion.About(pivot)), 0.01) << k;
    EXPECT_GT(Apart(surface, flows[k]->motion.About(pivot), {}), 0.2) << k;
  }
}

TEST(RigidFlow, StatesItsOwnNoise) {
  const SpeckledBall ball(5);
  const SurfaceMap surface = ball.Surface();
  const Eigen::Vector3d pivot = SpeckledBall::kCentre;
  double squares = 0.0;
  constexpr int kTrials = 12;
  for (int k = 0; k < kTrials; ++k) {
    const auto flow = FindRigidFlow(ball.Picture({}, 0.01, 1000 + k), ball.Picture({}, 0.01, 2000 + k), ball.Lit(),
                                    surface, ball.camera(), SpeckledBall::kLight, pivot);
    ASSERT_TRUE(flow);
    squares += flow->chi_squared / 6.0;
  }
  EXPECT_GT(squares / kTrials, 0.4) << "of still heads the motion over its stated covariance, 1 in the mean";
  EXPECT_LT(squares / kTrials, 2.0);
}

TEST(RigidFlow, SaysNothingWhereTooLittleIsLitOrNothingIsSeen) {
  const SpeckledBall ball(6);
  const SurfaceMap surface = ball.Surface();
  const Image<float> picture = ball.Picture({}, 0.01, 1);
  Image<uint8_t> spot(ball.width(), ball.height());
  for (int j = 60; j < 70; ++j)
    for (int i = 70; i < 80; ++i) spot(i, j) = 1;
  EXPECT_FALSE(
      FindRigidFlow(picture, picture, spot, surface, ball.camera(), SpeckledBall::kLight, SpeckledBall::kCentre));
  const Image<float> dark(ball.width(), ball.height());
  EXPECT_FALSE(
      FindRigidFlow(dark, dark, ball.Lit(), surface, ball.camera(), SpeckledBall::kLight, SpeckledBall::kCentre));
  const Image<float> saturated(ball.width(), ball.height(), 1, std::nanf(""));
  EXPECT_FALSE(FindRigidFlow(picture, saturated, ball.Lit(), surface, ball.camera(), SpeckledBall::kLight,
                             SpeckledBall::kCentre));
}

TEST(RigidFlow, ASpotThatShinesInOnePictureAloneMovesNothing) {
  const SpeckledBall ball(7);
  const SurfaceMap surface = ball.Surface();
  Image<float> later = ball.Picture({}, 0.005, 2);
  for (int j = 50; j < 62; ++j)
    for (int i = 60; i < 72; ++i) later(i, j) *= 1.5F;
  const auto flow = FindRigidFlow(ball.Picture({}, 0.005, 1), later, ball.Lit(), surface, ball.camera(),
                                  SpeckledBall::kLight, SpeckledBall::kCentre);
  ASSERT_TRUE(flow);
  EXPECT_LT(Apart(surface, flow->motion.About(SpeckledBall::kCentre), {}), 0.05);
}

TEST(FlowOptions, RefusesWhatMakesNoSense) {
  FlowOptions options;
  EXPECT_TRUE(options.Validate().ok());
  options.coarse_quads = 0.5;
  EXPECT_EQ(options.Validate().code(), StatusCode::kUsage);
  options = {};
  options.prior_shift_mm = 0.0;
  EXPECT_EQ(options.Validate().code(), StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::fit
