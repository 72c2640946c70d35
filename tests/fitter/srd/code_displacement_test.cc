// SPDX-License-Identifier: Apache-2.0
#include "fitter/srd/code_displacement.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

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
  // What the very surface mirrors is seen where it falls.
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
