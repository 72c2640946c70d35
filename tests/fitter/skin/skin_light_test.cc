// SPDX-License-Identifier: Apache-2.0
// What of a quad's light went through it: a plane of known reflectance in the light of four projectors.
#include "fitter/skin/skin_light.h"

#include <cmath>

#include <gtest/gtest.h>

#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr int kWidth = 24, kHeight = 16;  // quads
constexpr double kExposureMs = 5.0, kDirect = 0.15, kGlobal = 0.35;

struct Scene {
  RigCalibration rig;
  SurfaceMap surface;
  std::vector<SeparationMap> separation;
  std::vector<Image<uint8_t>> lit;

  explicit Scene(int projectors) {
    rig.camera.model = {2 * kWidth, 2 * kHeight, 1600, 1600, kWidth - 0.5, kHeight - 0.5, {}};
    surface = {Image<float>(kWidth, kHeight, 3), Image<float>(kWidth, kHeight, 3), Image<float>(kWidth, kHeight),
               Image<uint8_t>(kWidth, kHeight, 1, 1)};
    for (int j = 0; j < kHeight; ++j)
      for (int i = 0; i < kWidth; ++i) {
        const Eigen::Vector3d ray = rig.camera.model.Unproject(QuadCentre(Cfa::kRggb, i, j));
        for (int k = 0; k < 3; ++k) {
          surface.point_mm(i, j, k) = static_cast<float>(ray[k] * (700.0 / ray.z()));
          surface.normal(i, j, k) = k == 2 ? -1.0F : 0.0F;
        }
      }
    for (int p = 0; p < projectors; ++p) {
      ProjectorCalibration projector;
      projector.model = {1024, 768, 2690, 2690, 511, 384, {}};
      const double angle = 1.5 * p;
      projector.camera_from_projector = LookAt({300 * std::cos(angle), 300 * std::sin(angle), 0}, {0, 0, 700});
      projector.white_dn_mm2_per_ms = {1.1e8, 1.2e8, 1.0e8};
      rig.projectors.push_back(projector);
      const Image<float> light(kWidth, kHeight, 3);
      separation.push_back({light, light, light, light, Image<uint8_t>(kWidth, kHeight)});
      lit.emplace_back(kWidth, kHeight, 1, uint8_t{1});
      for (int j = 0; j < kHeight; ++j)
        for (int i = 0; i < kWidth; ++i) Light(p, i, j, kDirect, kGlobal);
    }
  }

  void Light(size_t p, int i, int j, double direct, double global) {
    for (int c = 0; c < 3; ++c) {
      const double white = rig.projectors[p].WhiteTargetDn(surface.Point(i, j), surface.Normal(i, j), c, kExposureMs);
      separation[p].direct(i, j, c) = static_cast<float>(direct * white);
      separation[p].global(i, j, c) = static_cast<float>(global * white);
    }
  }

  [[nodiscard]] SkinLight Measure() const {
    auto light = MeasureSkinLight(separation, lit, surface, rig, kExposureMs);
    EXPECT_TRUE(light.ok()) << light.status().message();
    return std::move(light).value();
  }
};

int64_t Count(const SkinLight& light, SkinReason reason) { return light.counts[static_cast<size_t>(reason)]; }

TEST(MeasureSkinLight, GivesReflectanceAndShareWhateverTheNumberOfProjectors) {
  for (const int projectors : {1, 2, 4}) {
    const SkinLight light = Scene(projectors).Measure();
    EXPECT_EQ(Count(light, SkinReason::kMeasured), kWidth * kHeight);
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(light.reflectance(7, 5, c), kGlobal, 1e-5);
      EXPECT_NEAR(light.share(7, 5, c), kGlobal / (kGlobal + kDirect), 1e-5);
    }
  }
}

TEST(MeasureSkinLight, TakesAProjectorThatLightsAQuadAlone) {
  Scene scene(2);
  scene.lit[0](7, 5) = 0;
  scene.Light(0, 7, 5, 9.0, 9.0);
  scene.separation[1].reason(8, 5) = static_cast<uint8_t>(SeparationReason::kSaturated);
  scene.Light(1, 8, 5, NAN, NAN);
  const SkinLight light = scene.Measure();
  EXPECT_NEAR(light.reflectance(7, 5, 0), kGlobal, 1e-5);
  EXPECT_NEAR(light.reflectance(8, 5, 0), kGlobal, 1e-5);
}

TEST(MeasureSkinLight, CountsWhatItCannotMeasure) {
  Scene scene(2);
  scene.surface.mask(1, 1) = 0;
  for (auto& lit : scene.lit) lit(2, 1) = 0;
  for (size_t p = 0; p < 2; ++p) {
    scene.Light(p, 3, 1, kDirect, -0.1);
    scene.Light(p, 4, 1, kDirect, 0.0);
    scene.Light(p, 5, 1, NAN, kGlobal);
    scene.Light(p, 6, 1, INFINITY, kGlobal);
  }
  const SkinLight light = scene.Measure();
  EXPECT_EQ(Count(light, SkinReason::kNoSurface), 1);
  EXPECT_EQ(Count(light, SkinReason::kUnlit), 1);
  EXPECT_EQ(Count(light, SkinReason::kNotPositive), 4);
  EXPECT_EQ(Count(light, SkinReason::kMeasured), kWidth * kHeight - 6);
  for (int i = 1; i <= 6; ++i) {
    EXPECT_TRUE(std::isnan(light.reflectance(i, 1, 0))) << i;
    EXPECT_TRUE(std::isnan(light.share(i, 1, 0))) << i;
  }
}

TEST(MeasureSkinLight, FacesAwayFromTheLight) {
  Scene scene(1);
  for (int k = 0; k < 3; ++k) scene.surface.normal(7, 5, k) = k == 2 ? 1.0F : 0.0F;
  EXPECT_EQ(Count(scene.Measure(), SkinReason::kUnlit), 1);
}

TEST(MeasureSkinLight, RefusesWhatDoesNotBelongTogether) {
  const auto code = [](const Scene& s, double exposure_ms = kExposureMs) {
    return MeasureSkinLight(s.separation, s.lit, s.surface, s.rig, exposure_ms).status().code();
  };
  Scene scene(2);
  EXPECT_EQ(code(scene, 0.0), StatusCode::kUsage);
  scene.separation.pop_back();
  EXPECT_EQ(code(scene), StatusCode::kUsage);
  scene = Scene(2);
  scene.lit.pop_back();
  EXPECT_EQ(code(scene), StatusCode::kUsage);
  scene = Scene(2);
  scene.lit[1] = Image<uint8_t>(kWidth, kHeight - 1);
  EXPECT_EQ(code(scene), StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::fit
