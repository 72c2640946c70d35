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

// A jump is no speed: what comes behind it goes on as what was before, also where the next projector's whites begin
// anew.
TEST(HeadMotion, GoesOnBehindAJumpAsBefore) {
  const SpeckledBall ball(1);
  std::vector<ProjectorFlows> flows = Steady(0.005);
  flows.push_back(flows.front());
  flows.back().first_s = 5.0;
  for (WhiteFlow& white : flows.back().later) white.seconds += 5.0;
  const Eigen::Vector3d jump(3.0, 0.0, 0.0);
  WhiteFlow& behind = flows[1].later.back();  // at 4.5 s
  behind.flow->motion.shift_mm += jump;
  const auto off = [&](double seconds) {
    const HeadMotion motion = TrackHead(flows, {}, SpeckledBall::kCentre, ball.Surface());
    const Eigen::Vector3d truth =
        After(seconds).About(SpeckledBall::kCentre) * SpeckledBall::kCentre + (seconds < 4.0 ? 0.0 : 1.0) * jump;
    return (motion.At(seconds) * SpeckledBall::kCentre - truth).norm();
  };
  EXPECT_GT(off(5.0), 0.3) << "of which nobody says that it is one";
  behind.behind_jump = true;
  for (const double seconds : {1.0, 2.5, 3.5, 4.5, 5.0, 6.0, 7.0}) EXPECT_LT(off(seconds), 0.05) << seconds;
  // What was shot again carries nothing, so nothing is said of where the head was meanwhile.
  flows[1].later.front().flow->motion.shift_mm += 3.0 * jump;
  const HeadMotion motion = TrackHead(flows, {}, SpeckledBall::kCentre, ball.Surface());
  EXPECT_GT((motion.At(3.5) * SpeckledBall::kCentre - SpeckledBall::kCentre).norm(), 9.0);
  EXPECT_LT(motion.largest_mm, 7.0);
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
