// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include <gtest/gtest.h>

#include "fitter/photometric/fuse_normals.h"
#include "fitter/photometric/photometric_stereo.h"
#include "shared/base/random.h"
#include "tests/fitter/geometry/synthetic_rig.h"

namespace stratalux::fit {
namespace {

constexpr double kExposureMs = 2.0;
constexpr double kAlbedo = 0.4;

// Direct images of a Lambertian sphere under the rig's near lights, noise-free.
class LambertSphere : public testing::Test {
 protected:
  LambertSphere() : truth_(TrueSurface(rig_, Sphere({0, 0, 680}, 80.0))) {
    for (const ProjectorCalibration& light : rig_.projectors) {
      Image<float> image(truth_.width(), truth_.height(), 1, std::nanf(""));
      for (int j = 0; j < truth_.height(); ++j)
        for (int i = 0; i < truth_.width(); ++i)
          if (truth_.mask(i, j) != 0)
            image(i, j) = static_cast<float>(
                kAlbedo * light.WhiteTargetDn(truth_.Point(i, j), truth_.Normal(i, j), 0, kExposureMs));
      direct_.push_back(std::move(image));
    }
  }
  [[nodiscard]] PhotometricMap Estimate(const RigCalibration& rig) const {
    std::vector<ImageView<const float>> views(direct_.begin(), direct_.end());
    auto map = EstimateNormals(views, truth_, rig, kExposureMs);
    EXPECT_TRUE(map.ok()) << map.status().message();
    return std::move(map).value();
  }
  // Largest angle to the true normal over a patch in the middle, lit by all four.
  [[nodiscard]] double WorstAngle(const PhotometricMap& map) const {
    double worst = 0.0;
    for (int j = 38; j < 58; ++j)
      for (int i = 50; i < 70; ++i) {
        if (map.reason(i, j) != 0) return INFINITY;
        const Eigen::Vector3d n(map.normal(i, j, 0), map.normal(i, j, 1), map.normal(i, j, 2));
        worst = std::max(worst, n.cross(truth_.Normal(i, j)).norm());
      }
    return worst;
  }
  void ScalePatch(int projector, float factor, float offset) {
    for (int j = 38; j < 58; ++j)
      for (int i = 50; i < 70; ++i) direct_[projector](i, j) = factor * direct_[projector](i, j) + offset;
  }
  RigCalibration rig_ = SyntheticRig();
  SurfaceMap truth_;
  std::vector<Image<float>> direct_;
};

TEST_F(LambertSphere, NormalsAndAlbedoAreExact) {
  const PhotometricMap map = Estimate(rig_);
  EXPECT_LT(WorstAngle(map), 1e-5);
  EXPECT_NEAR(map.albedo(60, 48), kAlbedo, 1e-5);
  EXPECT_EQ(map.usable(60, 48), 4);
  EXPECT_LT(map.residual(60, 48), 1e-5);
}

TEST_F(LambertSphere, DistantLightsAreWorse) {
  RigCalibration distant = rig_;
  for (ProjectorCalibration& p : distant.projectors) {
    // The same directions from the middle of the sphere, a hundred times farther, as bright there.
    const Eigen::Vector3d middle(0, 0, 600);
    p.camera_from_projector.translation_mm = middle + 100.0 * (p.CentreInCamera() - middle);
    for (double& white : p.white_dn_mm2_per_ms) white *= 1e4;
  }
  EXPECT_GT(WorstAngle(Estimate(distant)), 0.01);
}

TEST_F(LambertSphere, OneCastShadowIsRecovered) {
  ScalePatch(2, 0.0F, 0.0F);
  const PhotometricMap map = Estimate(rig_);
  EXPECT_LT(WorstAngle(map), 1e-5);
  EXPECT_EQ(map.usable(60, 48), 3);
}

TEST_F(LambertSphere, OneHighlightIsRejected) {
  // Where the sphere mirrors light 1 to the camera, its brightness is doubled.
  const Eigen::Vector3d light = rig_.projectors[1].CentreInCamera();
  int highlights = 0;
  for (int j = 0; j < truth_.height(); ++j)
    for (int i = 0; i < truth_.width(); ++i) {
      if (truth_.mask(i, j) == 0) continue;
      const Eigen::Vector3d x = truth_.Point(i, j);
      const Eigen::Vector3d half = ((light - x).normalized() - x.normalized()).normalized();
      if (half.dot(truth_.Normal(i, j)) > std::cos(0.1)) direct_[1](i, j) *= 2.0F;
    }
  const PhotometricMap map = Estimate(rig_);
  for (int j = 0; j < truth_.height(); ++j)
    for (int i = 0; i < truth_.width(); ++i) {
      if (truth_.mask(i, j) == 0) continue;
      const Eigen::Vector3d x = truth_.Point(i, j);
      const Eigen::Vector3d half = ((light - x).normalized() - x.normalized()).normalized();
      if (half.dot(truth_.Normal(i, j)) <= std::cos(0.1)) continue;
      ++highlights;
      ASSERT_EQ(map.reason(i, j), 0);
      ASSERT_EQ(map.usable(i, j), 3);
      const Eigen::Vector3d n(map.normal(i, j, 0), map.normal(i, j, 1), map.normal(i, j, 2));
      ASSERT_LT(n.cross(truth_.Normal(i, j)).norm(), 1e-4);
    }
  EXPECT_GT(highlights, 20);
}

TEST_F(LambertSphere, TwoKnownLightsAreTooFew) {
  ScalePatch(0, std::nanf(""), 0.0F);
  ScalePatch(3, std::nanf(""), 0.0F);
  const PhotometricMap map = Estimate(rig_);
  EXPECT_EQ(map.reason(60, 48), static_cast<uint8_t>(PhotometricReason::kTooFewSources));
  EXPECT_TRUE(std::isnan(map.normal(60, 48, 0)));
}

TEST_F(LambertSphere, FusionTakesLowFrequenciesFromTheSurface) {
  // A wrong light gain tilts all photometric normals smoothly; the surface corrects them, and a fine ripple survives.
  PhotometricMap map = Estimate(rig_);
  const auto ripple = [](int i) { return 0.05 * std::cos(2.0 * M_PI * i / 4.0); };
  for (int j = 0; j < truth_.height(); ++j)
    for (int i = 0; i < truth_.width(); ++i) {
      if (map.reason(i, j) != 0) continue;
      Eigen::Vector3d n = truth_.Normal(i, j) + Eigen::Vector3d(0.08 + ripple(i), 0, 0);
      n.normalize();
      for (int k = 0; k < 3; ++k) map.normal(i, j, k) = static_cast<float>(n[k]);
    }
  const auto fused = FuseNormals(truth_, map, {.sigma_quads = 6.0});
  ASSERT_TRUE(fused.ok());
  for (int i = 50; i < 70; ++i) EXPECT_NEAR((*fused)(i, 48, 0) - truth_.normal(i, 48, 0), ripple(i), 0.01) << i;
}

TEST_F(LambertSphere, FusionDoesNotAddNoiseToAGoodSurface) {
  Random random(5);
  for (Image<float>& image : direct_)
    for (float& value : image.pixels()) value *= static_cast<float>(1.0 + 0.03 * random.Normal());
  const PhotometricMap map = Estimate(rig_);
  const auto fused = FuseNormals(truth_, map, {.sigma_quads = 6.0});
  ASSERT_TRUE(fused.ok());
  double photometric = 0.0, after = 0.0;
  for (int j = 38; j < 58; ++j)
    for (int i = 50; i < 70; ++i) {
      if (map.usable(i, j) != 4) continue;
      for (int k = 0; k < 3; ++k) {
        photometric += std::pow(map.normal(i, j, k) - truth_.normal(i, j, k), 2);
        after += std::pow((*fused)(i, j, k) - truth_.normal(i, j, k), 2);
      }
    }
  EXPECT_GT(photometric, 0.0);
  EXPECT_LT(after, 0.1 * photometric);
}

TEST_F(LambertSphere, PredictsTheNoiseOfItsNormals) {
  Random random(6);
  for (Image<float>& image : direct_)
    for (float& value : image.pixels()) value *= static_cast<float>(1.0 + 0.01 * random.Normal());
  const PhotometricMap map = Estimate(rig_);
  double error = 0.0, predicted = 0.0;
  for (int j = 38; j < 58; ++j)
    for (int i = 50; i < 70; ++i) {
      ASSERT_EQ(map.usable(i, j), 4);
      for (int k = 0; k < 3; ++k) error += std::pow(map.normal(i, j, k) - truth_.normal(i, j, k), 2);
      predicted += std::pow(map.normal_sigma_rad(i, j), 2);
    }
  // The trace also counts the error along the normal, which moves the albedo alone.
  EXPECT_LT(error, 1.15 * predicted);
  EXPECT_GT(error, 0.5 * predicted);
}

}  // namespace
}  // namespace stratalux::fit
