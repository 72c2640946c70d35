// SPDX-License-Identifier: Apache-2.0
#include "fitter/motion/moved_surface.h"

#include <gmock/gmock.h>

#include "tests/fitter/motion/speckled_ball.h"

namespace stratalux::fit {
namespace {

const SmallMotion kMotion{{0.006, -0.009, 0.004}, {1.3, -0.9, 0.7}};

TEST(MovedSurface, IsTheBallWhereItIsThen) {
  const SpeckledBall ball(1);
  const Rigid3 pose = kMotion.About(SpeckledBall::kCentre);
  const MovedSurface moved = MoveSurface(ball.Surface(), ball.camera(), [&](const Eigen::Vector3d&) { return pose; });
  const SurfaceMap truth = ball.Surface(pose);
  int known = 0, of = 0;
  double worst_depth = 0.0, worst_angle = 0.0;
  for (int j = 0; j < ball.height(); ++j)
    for (int i = 0; i < ball.width(); ++i) {
      if (truth.mask(i, j) == 0 || truth.Normal(i, j).z() > -0.6) continue;
      ++of;
      if (moved.surface.mask(i, j) == 0) continue;
      ++known;
      worst_depth = std::max(worst_depth, std::abs(moved.surface.Point(i, j).z() - truth.Point(i, j).z()));
      worst_angle = std::max(worst_angle, (moved.surface.Normal(i, j) - truth.Normal(i, j)).norm());
    }
  EXPECT_GE(known, of - of / 200);
  EXPECT_LT(worst_depth, 0.05) << "a plane between quads 1.7 mm apart, on a ball of 85 mm";
  EXPECT_LT(worst_angle, 2e-3);
}

TEST(MovedSurface, EachQuadKnowsItsHome) {
  const SpeckledBall ball(2);
  const SurfaceMap surface = ball.Surface();
  const Rigid3 pose = kMotion.About(SpeckledBall::kCentre), back = pose.Inverse();
  const MovedSurface moved = MoveSurface(surface, ball.camera(), [&](const Eigen::Vector3d&) { return pose; });
  const Image<float> places = PlacesNow(surface, ball.camera(), [&](const Eigen::Vector3d&) { return pose; });
  int seen = 0;
  for (int j = 20; j < ball.height() - 20; ++j)
    for (int i = 20; i < ball.width() - 20; ++i) {
      if (moved.surface.mask(i, j) == 0 || moved.surface.Normal(i, j).z() > -0.6) continue;
      const Eigen::Vector2d home = ball.Seen(back * moved.surface.Point(i, j));
      EXPECT_LT((home - Eigen::Vector2d(moved.home(i, j, 0), moved.home(i, j, 1))).norm(), 0.03);
      const auto x = static_cast<int>(std::lround(home.x())), y = static_cast<int>(std::lround(home.y()));
      if (surface.mask(x, y) == 0) continue;
      const Eigen::Vector2d there(places(x, y, 0), places(x, y, 1));
      EXPECT_LE((there - Eigen::Vector2d(i, j)).cwiseAbs().maxCoeff(), 0.6) << i << ' ' << j;
      ++seen;
    }
  EXPECT_GT(seen, 1000);
}

TEST(MovedSurface, PlacesGoOnBeyondTheEdge) {
  SpeckledBall ball(3);
  SurfaceMap surface = ball.Surface();
  surface.mask(80, 65) = 0;  // a hole
  const Rigid3 pose{Eigen::Quaterniond::Identity(), {1.5, 0.0, 0.0}};
  const Image<float> places = PlacesNow(surface, ball.camera(), [&](const Eigen::Vector3d&) { return pose; });
  EXPECT_NEAR(places(80, 65, 0), 0.5 * (places(79, 65, 0) + places(81, 65, 0)), 0.02);
  EXPECT_NEAR(places(80, 65, 1), 65.0, 0.01);
  EXPECT_EQ(places(0, 0, 0), 0.0F) << "far from the surface nothing is known, and nothing moves";
}

TEST(MovedSurface, AStepIsNoSlope) {
  SpeckledBall ball(4);
  SurfaceMap surface = ball.Surface();
  for (int j = 0; j < ball.height(); ++j)
    for (int i = 81; i < ball.width(); ++i)
      if (surface.mask(i, j) != 0) surface.point_mm(i, j, 2) += 30.0F;  // behind the left half
  const Rigid3 pose{Eigen::Quaterniond::Identity(), {0.4, 0.0, 0.0}};
  const MovedSurface moved = MoveSurface(surface, ball.camera(), [&](const Eigen::Vector3d&) { return pose; });
  for (int i = 78; i < 85; ++i) {
    const double z = moved.surface.Point(i, 65).z(), front = ball.Surface().Point(i, 65).z();
    if (moved.surface.mask(i, 65) == 0) continue;
    EXPECT_TRUE(std::abs(z - front) < 1.0 || std::abs(z - front - 30.0) < 1.0) << z << " lies between " << front;
  }
}

}  // namespace
}  // namespace stratalux::fit
