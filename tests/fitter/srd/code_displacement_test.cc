// SPDX-License-Identifier: Apache-2.0
#include "fitter/srd/code_displacement.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "fitter/mixture/surface_reflection.h"
#include "tests/fitter/mixture/profile_directions.h"
#include "tests/fitter/srd/plane_scene.h"

namespace stratalux::fit {
namespace {

// `coded`, `scattered`: by projector, of every quad; empty: all.
Image<float> DisplacementOf(const RigCalibration& rig, const SurfaceMap& surface, const ScatteringModel& model,
                            std::vector<float> coded = {}, std::vector<float> scattered = {}) {
  coded.resize(rig.projectors.size(), coded.empty() ? 1.0F : 0.0F);
  scattered.resize(rig.projectors.size(), 1.0F);
  std::vector<Image<float>> weights, shares;
  for (const float weight : coded) weights.emplace_back(surface.width(), surface.height(), 1, weight);
  for (const float share : scattered) shares.emplace_back(surface.width(), surface.height(), 1, share);
  return CodeDisplacement(surface, weights, shares, rig, model);
}

// White light of projector 0 on a plane, two colours of `scattered` each and what a known surface mirrors, on profiles
// of `pool` x `pool` quads whose first one stands for all.
SrdBatch WhiteLight(const RigCalibration& rig, const SurfaceMap& plane, int pool, const ScatteringModel& model,
                    const std::array<double, 2>& scattered, const GlossField& gloss) {
  SrdBatch light;
  light.samples = 3;
  const int width = plane.width() / pool, height = plane.height() / pool;
  for (int64_t i = 0; i < int64_t{width} * height * 2; ++i) {
    const int x = static_cast<int>(i / 2 % width) * pool, y = static_cast<int>(i / 2 / width) * pool;
    const Eigen::Vector3d point = plane.Point(x, y), normal = plane.Normal(x, y), eye = -point.normalized(),
                          lamp = (rig.projectors[0].CentreInCamera() - point).normalized();
    test::AddDirections(lamp, eye, normal, normal.unitOrthogonal(), light);
    light.step_mm.push_back(1.0F);
    light.line_width_mm.push_back(1.0F);
    light.first_u_mm.push_back(0.0F);
    light.valid.push_back(1);
    light.noise_floor.push_back(0.0F);
    light.noise_slope.push_back(0.0F);
    const double mirrored =
        ReflectanceOf(model.reflection, ReflectionAngles::Between(lamp, eye, normal), model.eta, gloss.At(i));
    light.white.push_back(static_cast<float>(scattered[i % 2] + mirrored));
    light.white_variance.push_back(1e-8F);
    light.y.insert(light.y.end(), 3, light.white.back() / 3.0F);
  }
  return light;
}

TEST(ScatteredShares, AreWhatWhiteLightShowsBeyondTheSurface) {
  const RigCalibration rig = SmallRig();
  const SurfaceMap plane = Plane(rig, 0.2);
  ScatteringModel model;
  model.reflection = {1.2, 0.35};
  model.reflection.by_gloss.fill(0.9);
  for (const int pool : {1, 2, 3}) {
    const int width = plane.width() / pool, height = plane.height() / pool;
    const ProfileGrid grid{width, height, 2, 1.0 * pool};
    GlossField gloss = FlatGloss(grid);
    for (size_t k = 0; k < gloss.nodes.size(); ++k) gloss.nodes[k] = 0.2 * static_cast<double>(k % 5);
    model.reflection.gloss = gloss;
    SrdBatch light = WhiteLight(rig, plane, pool, model, {0.05, 0.11}, gloss);
    const int64_t dark = (int64_t{3} * width + 5) * 2, hair = (int64_t{4} * width + 6) * 2;
    light.valid[dark] = light.valid[dark + 1] = 0;
    light.apart.assign(light.valid.size(), 0);
    light.apart[hair] = light.apart[hair + 1] = 1;
    const SrdBatch* const lights[] = {&light};
    const auto shares = ScatteredShares(lights, grid, pool, plane, rig, model);
    ASSERT_EQ(shares.size(), rig.projectors.size());
    // Lit skin, hair, and what no light reaches; and a quad beyond the last whole pool.
    for (const auto& [i, j] : {std::pair(7 * pool, 9 * pool),
                               {14 * pool, 4 * pool},
                               {6 * pool, 4 * pool},
                               {5 * pool, 3 * pool},
                               {plane.width() - 1, plane.height() - 1}}) {
      const int x = std::min(i / pool, width - 1), y = std::min(j / pool, height - 1);
      const Eigen::Vector3d point = plane.Point(i, j);
      for (size_t p = 0; p < shares.size(); ++p) {
        const auto angles = ReflectionAngles::Between((rig.projectors[p].CentreInCamera() - point).normalized(),
                                                      -point.normalized(), plane.Normal(i, j));
        const double mirrored =
            ReflectanceOf(model.reflection, angles, model.eta, gloss.At((int64_t{y} * width + x) * 2));
        EXPECT_GT(mirrored, 0.001);
        EXPECT_NEAR(shares[p](i, j), 0.08 / (0.08 + mirrored), 2e-4) << x << " " << y << " of pools of " << pool;
      }
    }
  }
}

TEST(ScatteredShares, AreAllOfItWhereNoReflectionIsKnown) {
  const RigCalibration rig = SmallRig();
  const SurfaceMap plane = Plane(rig, 0.2);
  const SrdBatch light = WhiteLight(rig, plane, 1, {}, {0.05, 0.11}, {});
  const SrdBatch* const lights[] = {&light};
  for (const Image<float>& share : ScatteredShares(lights, {plane.width(), plane.height(), 2, 1.0}, 1, plane, rig, {}))
    EXPECT_TRUE(std::ranges::all_of(share.pixels(), [](float of) { return of == 1.0F; }));
}

TEST(CodeDisplacement, OfStraightRaysIsTheDepthItself) {
  // What codes at a depth do and what a deeper surface does are then the same.
  const RigCalibration rig = SmallRig();
  ScatteringModel model;
  model.shift_law = ShiftLaw::kPaper;
  for (const double tilt : {0.0, 0.4}) {
    const Image<float> g = DisplacementOf(rig, Plane(rig, tilt), model);
    EXPECT_NEAR(g(4, 4), 1.0F, 1e-5F);
  }
}

TEST(CodeDisplacement, OfOneLampBeforeAFrontalSurfaceIsTheRefractionsOwn) {
  const RigCalibration rig = SmallRig();
  const SurfaceMap plane = Plane(rig, 0.0);
  const int i = plane.width() / 2, j = plane.height() / 2;
  const Eigen::Vector3d point = plane.Point(i, j), to_lamp = rig.projectors[0].CentreInCamera() - point;
  const Eigen::Vector3d to_eye = -point.normalized(), normal = plane.Normal(i, j);
  ASSERT_GT(to_eye.dot(normal), 0.998);
  const double tangent = std::tan(std::acos(to_lamp.normalized().dot(normal)));
  const double refracted = std::tan(std::asin(std::sin(std::atan(tangent)) / 1.4));
  ScatteringModel model;
  model.eta = 1.4;
  EXPECT_NEAR(DisplacementOf(rig, plane, model)(i, j), refracted / tangent, 0.02);
  EXPECT_NEAR(DisplacementOf(rig, plane, model, {0.0F})(i, j), refracted / tangent, 0.02)
      << "coded by none: by all it faces";
}

TEST(CodeDisplacement, IsWhatLeastSquaresMakesOfDisplacedCodes) {
  // Codes that the refracted rays displace, triangulated by brute force along the view.
  RigCalibration rig = SmallRig();
  rig.projectors.push_back(rig.projectors[0]);
  rig.projectors[1].camera_from_projector.translation_mm += Eigen::Vector3d(520.0, 90.0, 0.0);
  const SurfaceMap plane = Plane(rig, 0.3);
  const int i = plane.width() / 3, j = plane.height() / 2;
  const Eigen::Vector3d point = plane.Point(i, j), normal = plane.Normal(i, j), view = point.normalized();
  ScatteringModel model;
  model.eta = 1.4;
  const auto refracted = [&](const Eigen::Vector3d& direction) -> Eigen::Vector3d {
    const Eigen::Vector3d inside = direction / 1.4, across = inside - inside.dot(normal) * normal;
    return across / std::sqrt(1.0 - across.squaredNorm());
  };
  constexpr double kDepth = 0.2;
  std::vector<double> coded = {1.0, 1.0}, scattered = {1.0, 1.0};
  const auto error_at = [&](double too_deep) {
    double squares = 0.0;
    for (size_t p = 0; p < coded.size(); ++p) {
      const ProjectorCalibration& projector = rig.projectors[p];
      const Eigen::Vector3d to_lamp = (projector.CentreInCamera() - point).normalized();
      const double cos_in = to_lamp.dot(normal);
      if (cos_in < 0.1) continue;
      // On the tangent plane: where the light came in, and where the lamp's ray through the point too deep meets it.
      const Eigen::Vector3d came_in = scattered[p] * kDepth * (refracted(to_lamp) - refracted(-view));
      const Eigen::Vector3d moved = too_deep * (to_lamp / cos_in - -view / -view.dot(normal));
      squares += coded[p] * std::pow(cos_in, 2) * (came_in - moved).squaredNorm();
    }
    return squares;
  };
  const auto best = [&] {
    double least = 0.0;
    for (double h = 0.0; h < 0.3; h += 1e-4)
      if (error_at(h) < error_at(least)) least = h;
    return least;
  };
  const double of_both = best();
  EXPECT_NEAR(DisplacementOf(rig, plane, model)(i, j) * kDepth, of_both, 2e-4);
  // A projector counts as far as its codes took part.
  coded = {1.0, 0.0};
  EXPECT_NEAR(DisplacementOf(rig, plane, model, {1.0F, 0.0F})(i, j) * kDepth, best(), 2e-4);
  EXPECT_GT(std::abs(best() - of_both), 2e-3);
  coded = {0.25, 1.0};
  EXPECT_NEAR(DisplacementOf(rig, plane, model, {0.25F, 1.0F})(i, j) * kDepth, best(), 2e-4);
  // What the surface itself mirrors is seen where it falls.
  coded = {1.0, 1.0};
  scattered = {0.3, 0.9};
  EXPECT_NEAR(DisplacementOf(rig, plane, model, {1.0F, 1.0F}, {0.3F, 0.9F})(i, j) * kDepth, best(), 2e-4);
  EXPECT_LT(best(), 0.8 * of_both);
}

TEST(CodeDisplacement, IsNothingWhereNoSurfaceIs) {
  const RigCalibration rig = SmallRig();
  SurfaceMap plane = Plane(rig, 0.0);
  plane.mask(3, 3) = 0;
  EXPECT_EQ(DisplacementOf(rig, plane, {})(3, 3), 0.0F);
}

}  // namespace
}  // namespace stratalux::fit
