// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/lit_surface.h"

#include <array>
#include <cmath>

#include <gtest/gtest.h>

#include "tests/fitter/render/lit_scene.h"

namespace stratalux::fit {
namespace {

const Eigen::Vector3d kOblique(-350.0, 40.0, 150.0);  // 45 degrees to the left of the scene's middle

TEST(BuildLitSurface, PutsEverySampleOnTheRayOfItsOwnPixel) {
  const LitScene scene = MakeScene(FaceLike(), kOblique);
  int lit = 0;
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 160; ++x) {
      const LitSample& s = scene.lit.samples(x, y);
      if (s.flux[0] == 0.0F) continue;
      ++lit;
      const auto pixel = scene.lit.light.ProjectFromCamera(s.point_mm.cast<double>());
      ASSERT_TRUE(pixel);
      EXPECT_NEAR(pixel->x(), x, 0.05);
      EXPECT_NEAR(pixel->y(), y, 0.05);
    }
  EXPECT_GT(lit, 4000);
}

TEST(BuildLitSurface, GivesTheWhiteTargetTimesTheTrueAreaOfThePatch) {
  const LitScene scene = MakeScene(FaceLike(), kOblique);
  const Image<LitSample>& s = scene.lit.samples;
  int compared = 0;
  for (int y = 1; y < 119; ++y)
    for (int x = 1; x < 159; ++x) {
      const auto lit = [&](int i, int j) { return s(i, j).flux[0] > 0.0F; };
      if (!lit(x, y) || !lit(x - 1, y) || !lit(x + 1, y) || !lit(x, y - 1) || !lit(x, y + 1)) continue;
      const Eigen::Vector3d du = 0.5 * (s(x + 1, y).point_mm - s(x - 1, y).point_mm).cast<double>(),
                            dv = 0.5 * (s(x, y + 1).point_mm - s(x, y - 1).point_mm).cast<double>();
      if (du.norm() > 1.0 || dv.norm() > 1.0) continue;  // across the edge of a shadow
      const double area = du.cross(dv).norm();
      for (int c = 0; c < 3; ++c) {
        // The normal is that of the facet itself, so that both sides speak of the same patch.
        Eigen::Vector3d n = du.cross(dv).normalized();
        if (n.z() > 0.0) n = -n;
        const double dn = scene.lit.light.WhiteTargetDn(s(x, y).point_mm.cast<double>(), n, c, kExposureMs);
        EXPECT_NEAR(s(x, y).flux[c] / (dn * area), 1.0, 0.01);
      }
      ++compared;
    }
  EXPECT_GT(compared, 4000);
}

TEST(BuildLitSurface, LeavesTheNosesShadowDark) {
  const LitScene scene = MakeScene(FaceLike(), {-450.0, 0.0, 250.0});
  // A surface point is lit when a sample lies next to it.
  auto lit_at = [&](double x) {
    const Height h = FaceLike()(x, 0.0);
    const auto pixel = scene.lit.light.ProjectFromCamera({x, 0.0, h.z});
    const LitSample& s =
        scene.lit.samples(static_cast<int>(std::lround(pixel->x())), static_cast<int>(std::lround(pixel->y())));
    return s.flux[0] > 0.0F && (s.point_mm.cast<double>() - Eigen::Vector3d(x, 0.0, h.z)).norm() < 0.6;
  };
  // March from the point towards the lamp: does the ray dive below the surface?
  auto hidden = [&](double x) {
    const Eigen::Vector3d p(x, 0.0, FaceLike()(x, 0.0).z),
        towards = (scene.lit.light.CentreInCamera() - p).normalized();
    for (double t = 0.3; t < 30.0; t += 0.1) {
      const Eigen::Vector3d q = p + t * towards;
      if (q.z() > FaceLike()(q.x(), q.y()).z + 0.05) return true;
    }
    return false;
  };
  ASSERT_TRUE(hidden(5.0));
  int dark = 0, bright = 0;
  for (double x = -15.0; x <= 15.0; x += 0.25) {
    // The shadow's edge is as sharp as the quads, so stay off it.
    if (hidden(x) != hidden(x - 1.5) || hidden(x) != hidden(x + 1.5)) continue;
    EXPECT_EQ(lit_at(x), !hidden(x)) << "x = " << x;
    ++(hidden(x) ? dark : bright);
  }
  EXPECT_GT(dark, 4);
  EXPECT_GT(bright, 40);
}

TEST(BuildLitSurface, BridgesNoDiscontinuityOfDepth) {
  LitScene scene = MakeScene(FrontalPlane(), {0.0, 0.0, 0.0});
  for (int j = 0; j < 36; ++j)
    for (int i = 24; i < 48; ++i)
      for (int k = 0; k < 3; ++k) scene.surface.point_mm(i, j, k) *= 1.1F;  // the right half lies 50 mm behind
  const LitSurface lit = BuildLitSurface(scene.surface, scene.rig.projectors[0], kExposureMs);
  int near = 0, far = 0;
  for (const LitSample& s : lit.samples.pixels()) {
    if (s.flux[0] == 0.0F) continue;
    const float z = s.point_mm.z();
    EXPECT_TRUE(std::abs(z - 500.0F) < 0.01F || std::abs(z - 550.0F) < 0.01F) << z;
    ++(z < 525.0F ? near : far);
  }
  EXPECT_GT(near, 1000);
  EXPECT_GT(far, 1000);
}

TEST(LightWith, KeepsTheFluxAndItsCentroidOnEveryLevel) {
  const LitScene scene = MakeScene(FaceLike(), kOblique);
  const Pattern spots{.kind = PatternKind::kSpots, .period = 32, .width = 4};
  const LitPyramid pyramid = LightWith(scene.lit, spots);
  auto moments = [](const LitPlanes& level) {
    Eigen::Vector4d sum = Eigen::Vector4d::Zero();
    for (size_t k = 0; k < level.flux.size(); ++k)
      sum += double{level.flux[k]} * Eigen::Vector3d(level.x[k], level.y[k], level.z[k]).homogeneous();
    return sum;
  };
  const Eigen::Vector4d fine = moments(pyramid.levels[0]);
  ASSERT_GT(fine.w(), 0.0);
  ASSERT_EQ(pyramid.levels.size(), 7U);
  for (const LitPlanes& level : pyramid.levels) {
    const Eigen::Vector4d m = moments(level);
    EXPECT_NEAR(m.w() / fine.w(), 1.0, 1e-5);
    EXPECT_LT((m.hnormalized() - fine.hnormalized()).norm(), 1e-3);
  }
}

TEST(LightWith, BlursTheLineWithoutLosingLight) {
  const LitScene scene = MakeScene(FrontalPlane(), {0.0, 0.0, 0.0}, Cfa::kMono, 1.2);
  const LitPyramid pyramid = LightWith(scene.lit, MiddleLine(scene, 4), 0.9);
  double sum = 0.0, square = 0.0;
  for (int x = 0; x < 160; ++x) {
    sum += pyramid.pattern(x, 60);
    square += pyramid.pattern(x, 60) * (x - 79.5) * (x - 79.5);
  }
  EXPECT_NEAR(sum, 4 * 0.9, 1e-4);
  // Variances add: four columns (4^2 - 1) / 12 and the optics 1.2^2.
  EXPECT_NEAR(square / sum, 15.0 / 12.0 + 1.44, 0.01);
}

TEST(MakePointLight, ReadsTheAskedLevelInTheMiddleAndLightsTheWholeSurface) {
  const LitScene scene = MakeScene(FaceLike(), kOblique);
  const Eigen::Vector3d lamp(120.0, -80.0, 100.0);
  const auto made = MakePointLight(scene.surface, lamp, {500.0, 900.0, 300.0});
  ASSERT_TRUE(made.ok()) << made.status().message();
  const ProjectorCalibration& light = *made;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (int j = 0; j < 36; ++j)
    for (int i = 0; i < 48; ++i) {
      centre += scene.surface.Point(i, j) / (48.0 * 36.0);
      const auto pixel = light.ProjectFromCamera(scene.surface.Point(i, j));
      ASSERT_TRUE(pixel && light.model.Contains(*pixel));
    }
  EXPECT_NEAR(light.WhiteTargetDn(centre, (lamp - centre).normalized(), 1, 1.0), 900.0, 0.1);
  const LitSurface lit = BuildLitSurface(scene.surface, light, 1.0);
  int samples = 0;
  for (const LitSample& s : lit.samples.pixels()) samples += s.flux[0] > 0.0F ? 1 : 0;
  EXPECT_GT(samples, 48 * 36 * 4);  // finer than the camera
}

TEST(LitPyramid, KnowsTheLeastWindowOfItsLight) {
  const LitScene scene = MakeScene(FaceLike(), {-350.0, 0.0, 150.0});
  const LitPyramid pyramid = LightWith(scene.lit, MiddleLine(scene, 2));
  for (const LitPlanes& planes : pyramid.levels) {
    BlockWindow found;
    for (int y = 0; y < planes.height; ++y)
      for (int x = 0; x < planes.width; ++x)
        if (planes.flux[static_cast<size_t>(y) * planes.stride + x] > 0.0F) found = found.With({x, x, y, y});
    EXPECT_EQ((std::array<int, 4>{planes.lit.x0, planes.lit.x1, planes.lit.y0, planes.lit.y1}),
              (std::array<int, 4>{found.x0, found.x1, found.y0, found.y1}));
  }
  EXPECT_EQ(pyramid.shown_lit.x1 - pyramid.shown_lit.x0 + 1, 2);
  EXPECT_EQ(pyramid.shown_lit.y0, 0);
  EXPECT_EQ(pyramid.shown_lit.y1, pyramid.shown.height() - 1);
}

// As large as a face: 190 mm wide, its nose 35 mm high.
SurfaceMap LargeSurface(const HeightField& field) {
  SurfaceMap surface = MakeScene(field, Eigen::Vector3d::Zero()).surface;
  for (float& coordinate : surface.point_mm.pixels()) coordinate *= 5.0F;
  return surface;
}

// Beside the nose it has skin before, beside and behind it, seen from where it looks at the centre.
TEST(MakePointLight, LightsAllSkinThatFacesItFromTwentyMillimetres) {
  const SurfaceMap surface = LargeSurface(FaceLike());
  for (const auto& [i, j] : {std::pair(40, 18), {8, 18}, {24, 4}, {36, 30}}) {
    const Eigen::Vector3d foot = surface.Point(i, j), lamp = foot + 20.0 * surface.Normal(i, j);
    const auto light = MakePointLight(surface, lamp, {1.0, 1.0, 1.0});
    ASSERT_TRUE(light.ok()) << light.status().message();
    int seen = 0;
    for (int y = 0; y < surface.height(); ++y)
      for (int x = 0; x < surface.width(); ++x) {
        const Eigen::Vector3d point = surface.Point(x, y), to_lamp = lamp - point;
        if (surface.Normal(x, y).dot(to_lamp.normalized()) < 0.2) continue;
        const auto pixel = light->ProjectFromCamera(point);
        EXPECT_TRUE(pixel && light->model.Contains(*pixel)) << "lamp " << i << " " << j << ", quad " << x << " " << y;
        ++seen;
      }
    EXPECT_GT(seen, 100);
    const LitSurface lit = BuildLitSurface(surface, *light, 1.0);
    const auto under = light->ProjectFromCamera(foot);
    ASSERT_TRUE(under);
    const LitSample& sample =
        lit.samples(static_cast<int>(std::lround(under->x())), static_cast<int>(std::lround(under->y())));
    EXPECT_GT(sample.flux[0], 0.0F);
    EXPECT_LT((sample.point_mm.cast<double>() - foot).norm(), 2.0);
  }
}

TEST(MakePointLight, RefusesToLeaveSkinDarkAllAroundIt) {
  // A bowl whose rim stands higher than the lamp, 20 mm above its ground.
  const SurfaceMap surface = LargeSurface([](double x, double y) {
    return Height{kDistanceMm - (x * x + y * y) / 40.0, -x / 20.0, -y / 20.0};
  });
  const auto light = MakePointLight(surface, surface.Point(24, 18) - Eigen::Vector3d(0.0, 0.0, 20.0), {1.0, 1.0, 1.0});
  ASSERT_FALSE(light.ok());
  EXPECT_EQ(light.status().code(), StatusCode::kUsage);
  EXPECT_NE(light.status().message().find("stands among the face"), std::string::npos) << light.status().message();
}

}  // namespace
}  // namespace stratalux::fit
