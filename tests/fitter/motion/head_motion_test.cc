// SPDX-License-Identifier: Apache-2.0
#include "fitter/motion/head_motion.h"

#include <gmock/gmock.h>

#include "tests/fitter/motion/speckled_ball.h"

namespace stratalux::fit {
namespace {

const Eigen::Vector3d kSpeedMm{0.1, -0.05, 0.02}, kTurn{0.001, 0.0, 0.002};  // a second

SmallMotion After(double seconds) { return {seconds * kTurn, seconds * kSpeedMm}; }

// Whites of two projectors of a head that moves at one speed: at 0, 1, 2 s and, after a gap, at 2.5, 3, 4 s.
std::vector<ProjectorFlows> Steady(double sigma_mm) {
  std::vector<ProjectorFlows> flows = {{0, 0.0, {}}, {1, 2.5, {}}};
  for (ProjectorFlows& of : flows)
    for (const double later : {of.first_s + 1.0, of.first_s + 2.0}) {
      RigidFlow flow;
      flow.motion = After(later - of.first_s);
      flow.covariance *= sigma_mm * sigma_mm;
      flow.covariance.topLeftCorner<3, 3>() /= 85.0 * 85.0;
      flow.chi_squared = flow.motion.Vector().dot(flow.covariance.inverse() * flow.motion.Vector());
      of.later.push_back({later, flow});
    }
  return flows;
}

TEST(HeadMotion, IsOneTrackOverAllProjectorsAndGoesOnThroughGaps) {
  const SpeckledBall ball(1);
  const auto flows = Steady(0.005);
  const HeadMotion motion = TrackHead(flows, {}, SpeckledBall::kCentre, ball.Surface());
  ASSERT_TRUE(motion.moved);
  for (const double seconds : {0.0, 0.7, 2.0, 2.3, 3.1, 4.5}) {
    const Rigid3 found = motion.At(seconds), truth = After(seconds).About(SpeckledBall::kCentre);
    const Eigen::Vector3d point = SpeckledBall::kCentre + Eigen::Vector3d(30.0, 40.0, -60.0);
    EXPECT_LT((found * point - truth * point).norm(), 1e-3) << seconds;
  }
  EXPECT_LT((motion.At(99.0) * SpeckledBall::kCentre - motion.At(4.5) * SpeckledBall::kCentre).norm(), 1e-12);
  EXPECT_LT((motion.At(-1.0) * SpeckledBall::kCentre - SpeckledBall::kCentre).norm(), 1e-12);
}

TEST(HeadMotion, NoiseIsNoMotion) {
  const SpeckledBall ball(1);
  EXPECT_FALSE(TrackHead(Steady(0.5), {}, SpeckledBall::kCentre, ball.Surface()).moved)
      << "0.5 mm of motion with 0.9 of noise";
  std::vector<ProjectorFlows> tiny = Steady(1e-4);
  for (ProjectorFlows& of : tiny)
    for (WhiteFlow& white : of.later) white.flow->motion = SmallMotion::From(0.03 * white.flow->motion.Vector());
  const HeadMotion motion = TrackHead(tiny, {}, SpeckledBall::kCentre, ball.Surface());
  EXPECT_GT(motion.largest_mm, 0.01);
  EXPECT_FALSE(motion.moved) << "less than least_mm is left alone, however certain";
  EXPECT_LT((motion.At(3.0) * SpeckledBall::kCentre - SpeckledBall::kCentre).norm(), 1e-15);
}

TEST(HeadMotion, OfAProjectorWithoutWhitesTheOthersSpeak) {
  const SpeckledBall ball(1);
  auto flows = Steady(0.005);
  for (WhiteFlow& white : flows[1].later) white.flow.reset();
  const HeadMotion motion = TrackHead(flows, {}, SpeckledBall::kCentre, ball.Surface());
  ASSERT_TRUE(motion.moved);
  EXPECT_NEAR(motion.At(2.5).translation_mm.x(), After(2.5).About(SpeckledBall::kCentre).translation_mm.x(), 0.02);
  for (ProjectorFlows& of : flows)
    for (WhiteFlow& white : of.later) white.flow.reset();
  const HeadMotion unknown = TrackHead(flows, {}, SpeckledBall::kCentre, ball.Surface());
  EXPECT_FALSE(unknown.moved);
  EXPECT_TRUE(unknown.poses.empty());
}

}  // namespace
}  // namespace stratalux::fit
