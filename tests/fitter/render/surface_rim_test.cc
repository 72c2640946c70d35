// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/surface_rim.h"

#include <Eigen/Geometry>
#include <cmath>
#include <span>

#include <gtest/gtest.h>

#include "fitter/reconstruction/components.h"
#include "fitter/render/mlsss.h"
#include "tests/fitter/render/lit_scene.h"

namespace stratalux::fit {
namespace {

HeightField SlantedPlane() {
  return [](double x, double y) { return Height{kDistanceMm + 1.2 * x + 0.3 * y, 1.2, 0.3}; };
}

// Without the columns from `first` on.
SurfaceMap CutOff(SurfaceMap surface, int first) {
  for (int j = 0; j < surface.height(); ++j)
    for (int i = first; i < surface.width(); ++i) ForgetQuad(surface, i, j);
  return surface;
}

TEST(SurfaceRim, APlaneGoesOnByOneQuad) {
  const SurfaceMap whole = MakeScene(SlantedPlane(), {0.0, 0.0, 0.0}).surface, rimmed = WithRim(CutOff(whole, 30));
  for (int j = 0; j < whole.height(); ++j) {
    ASSERT_EQ(rimmed.mask(30, j), 1) << j;
    EXPECT_EQ(rimmed.mask(31, j), 0) << j;
    EXPECT_LT((rimmed.Point(30, j) - whole.Point(30, j)).norm(), 0.02) << j;
    EXPECT_LT(std::abs(whole.Normal(30, j).dot(rimmed.Point(30, j) - whole.Point(29, j))), 1e-4) << "in the plane";
    EXPECT_LT((rimmed.Normal(30, j) - whole.Normal(30, j)).norm(), 1e-5) << j;
    EXPECT_EQ(rimmed.Point(29, j), whole.Point(29, j)) << "what is known stays";
  }
}

TEST(SurfaceRim, AHoleInADomeIsFilledAsItBends) {
  const SurfaceMap whole = MakeScene(FaceLike(), {0.0, 0.0, 0.0}).surface;
  SurfaceMap holed = whole;
  ForgetQuad(holed, 40, 8);
  const SurfaceMap rimmed = WithRim(holed);
  ASSERT_EQ(rimmed.mask(40, 8), 1);
  EXPECT_LT((rimmed.Point(40, 8) - whole.Point(40, 8)).norm(), 0.03);
  EXPECT_LT((rimmed.Normal(40, 8) - whole.Normal(40, 8)).norm(), 0.01);
}

TEST(SurfaceRim, NothingStandsBetweenTwoSurfaces) {
  SurfaceMap steps = MakeScene(FrontalPlane(), {0.0, 0.0, 0.0}).surface;
  for (int j = 0; j < steps.height(); ++j) {
    for (int i = 25; i < steps.width(); ++i)
      for (int k = 0; k < 3; ++k) steps.point_mm(i, j, k) *= 1.1F;
    ForgetQuad(steps, 24, j);
  }
  const SurfaceMap between = WithRim(steps);
  for (int j = 0; j < steps.height(); ++j) EXPECT_EQ(between.mask(24, j), 0) << j;
}

// Where the camera grazes it, the skin goes round the corner: on its own tangent plane, not to the next camera ray,
// which may meet that far behind.
TEST(SurfaceRim, GoesRoundASilhouette) {
  constexpr double kRadius = 14.0;
  const LitScene scene = MakeScene(
      [](double x, double y) {
        const double r2 = std::min(x * x + y * y, 0.9985 * kRadius * kRadius), z = std::sqrt(kRadius * kRadius - r2);
        return Height{kDistanceMm + kRadius - z, x / z, y / z};
      },
      {0.0, 0.0, 0.0});
  SurfaceMap ball = scene.surface;
  const Eigen::Vector3d centre(0.0, 0.0, kDistanceMm + kRadius);
  for (int j = 0; j < ball.height(); ++j)
    for (int i = 0; i < ball.width(); ++i)
      if (ball.Point(i, j).head<2>().norm() > 0.995 * kRadius ||
          std::abs((ball.Point(i, j) - centre).norm() - kRadius) > 0.2)
        ForgetQuad(ball, i, j);
  const SurfaceMap rimmed = WithRim(ball);
  int round = 0;
  for (int j = 0; j < ball.height(); ++j)
    for (int i = 0; i < ball.width(); ++i) {
      if (ball.mask(i, j) != 0 || rimmed.mask(i, j) == 0) continue;
      ++round;
      EXPECT_NEAR((rimmed.Point(i, j) - centre).norm(), kRadius, 1.5) << i << ' ' << j;
    }
  EXPECT_GT(round, 20);
}

// Light that enters beyond the last quad comes out of it: with the rim lit, a surface that ends there is nearly as
// bright at its edge as one that goes on.
TEST(SurfaceRim, TheLastQuadIsNearlyAsBrightAsWhereTheSurfaceGoesOn) {
  const Eigen::Vector3d lamp(-300.0, 0.0, 100.0);
  const LitScene whole = MakeScene(FrontalPlane(), lamp);
  const MixtureMap skin = UniformSkin(whole, {{0.6F, 0.2F, 0.5F}});
  constexpr int kLast = 29;
  // Of the last quad, by what of the surface is lit.
  const SurfaceMap cut = CutOff(whole.surface, kLast + 1);
  const auto at_the_edge = [&](const SurfaceMap& lit_surface) {
    const LitSurface lit = BuildLitSurface(lit_surface, whole.lit.light, kExposureMs);
    const LitPyramid light = LightWith(lit, {.kind = PatternKind::kWhite});
    return RenderSubsurface(skin, cut, whole.rig, lit, std::span(&light, 1))[0](kLast, cut.height() / 2, 0);
  };
  const float all = at_the_edge(whole.surface);
  EXPECT_GT(at_the_edge(WithRim(cut)) / all, 0.9F);
  EXPECT_LT(at_the_edge(cut) / all, 0.7F) << "what the rim is for";
}

}  // namespace
}  // namespace stratalux::fit
