// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>

#include "fitter/image/gaussian_blur.h"
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
  [[nodiscard]] std::vector<LitImage> Lit(const RigCalibration& rig) const {
    std::vector<LitImage> images;
    for (size_t p = 0; p < direct_.size(); ++p)
      images.push_back({LightOfProjector(rig.projectors[p], kExposureMs), direct_[p], {}});
    return images;
  }
  [[nodiscard]] PhotometricMap Estimate(const RigCalibration& rig, const PhotometricOptions& options = {}) const {
    auto map = EstimateNormals(Lit(rig), truth_, options);
    EXPECT_TRUE(map.ok()) << map.status().message();
    return std::move(map).value();
  }
  // A surface that says of such a blur.
  [[nodiscard]] SurfaceMap Blurred(float quads) const {
    SurfaceMap surface = truth_;
    surface.smoothing_quads = Image<float>(truth_.width(), truth_.height(), 1, quads);
    return surface;
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

TEST_F(LambertSphere, TwoKnownLightsLeanOnTheSurface) {
  ScalePatch(0, std::nanf(""), 0.0F);
  ScalePatch(3, std::nanf(""), 0.0F);
  const PhotometricMap map = Estimate(rig_);
  EXPECT_EQ(map.reason(60, 48), static_cast<uint8_t>(PhotometricReason::kTooFewSources));
  EXPECT_EQ(map.usable(60, 48), 2);
  for (int k = 0; k < 3; ++k) EXPECT_NEAR(map.normal(60, 48, k), truth_.normal(60, 48, k), 1e-5);
  EXPECT_GT(map.normal_sigma_rad(60, 48), 0.5 * PhotometricOptions{}.surface_sigma_rad);
  EXPECT_LT(map.normal_sigma_rad(60, 48), std::sqrt(2.0) * PhotometricOptions{}.surface_sigma_rad);
  EXPECT_NEAR(map.albedo(60, 48), kAlbedo, 1e-4);
}

TEST_F(LambertSphere, WithoutSurfaceThereIsNoNormal) {
  truth_.mask(60, 48) = 0;
  const PhotometricMap map = Estimate(rig_);
  EXPECT_EQ(map.reason(60, 48), static_cast<uint8_t>(PhotometricReason::kNoSurface));
  EXPECT_TRUE(std::isnan(map.normal(60, 48, 0)));
  EXPECT_TRUE(std::isnan(map.normal_sigma_rad(60, 48)));
}

TEST_F(LambertSphere, WhatIsNoLightIsMaskedAndCounted) {
  direct_[0](60, 48) = std::nanf("");
  direct_[1](61, 48) = INFINITY;
  direct_[2](62, 48) = -1.0F;
  Image<float> variance(truth_.width(), truth_.height(), 1, 1.0F);
  variance(63, 48) = std::nanf("");
  variance(64, 48) = -1.0F;
  direct_[3](65, 48) = -1.0F;  // one standard deviation: no light, and no fault
  std::vector<LitImage> images = Lit(rig_);
  images[3].variance = variance;
  const auto map = EstimateNormals(images, truth_);
  ASSERT_TRUE(map.ok());
  EXPECT_EQ(map->masked_not_finite, 3);
  EXPECT_EQ(map->masked_negative, 2);
  for (int i = 60; i < 66; ++i) {
    EXPECT_EQ(map->usable(i, 48), 3) << i;
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(map->normal(i, 48, k), truth_.normal(i, 48, k), 1e-4) << i;
  }
}

TEST_F(LambertSphere, ProjectorsAreLightsOfTheirWhite) {
  ProjectorCalibration& projector = rig_.projectors[1];
  projector.falloff = {-0.3, 0.05};
  const PhotometricLight light = LightOfProjector(projector, kExposureMs);
  for (const Eigen::Vector3d& x : {Eigen::Vector3d(0, 0, 600), Eigen::Vector3d(40, -30, 650)}) {
    const LightAtPoint at = light.At(x);
    for (int c = 0; c < 3; ++c) {
      const double white = projector.WhiteTargetDn(x, at.to_light, c, kExposureMs);
      EXPECT_NEAR(at.white_dn[static_cast<size_t>(c)], white, 1e-9 * white);
    }
  }
  EXPECT_EQ(light.At({0, 0, -5000}).white_dn[0], 0.0);  // behind it
}

// Lights of their own, without a rig: images of the sphere under each.
class LightsOverSphere : public LambertSphere {
 protected:
  void Shine(const std::vector<PhotometricLight>& lights) {
    direct_.clear();
    images_.clear();
    for (const PhotometricLight& light : lights) {
      direct_.emplace_back(truth_.width(), truth_.height(), 1, std::nanf(""));
      for (int j = 0; j < truth_.height(); ++j)
        for (int i = 0; i < truth_.width(); ++i) {
          if (truth_.mask(i, j) == 0) continue;
          const LightAtPoint at = light.At(truth_.Point(i, j));
          const double cosine = std::max(0.0, truth_.Normal(i, j).dot(at.to_light));
          direct_.back()(i, j) = static_cast<float>(kAlbedo * at.white_dn[0] * cosine);
        }
    }
    for (size_t s = 0; s < lights.size(); ++s) images_.push_back({lights[s], direct_[s], {}});
  }
  [[nodiscard]] PhotometricMap Estimate() const {
    auto map = EstimateNormals(images_, truth_);
    EXPECT_TRUE(map.ok()) << map.status().message();
    return std::move(map).value();
  }
  // Seven around the camera, `distance_mm` from the sphere.
  [[nodiscard]] static std::vector<PhotometricLight> Around(double distance_mm) {
    std::vector<PhotometricLight> lights;
    for (int s = 0; s < 7; ++s) {
      const double azimuth = 2.0 * M_PI * s / 7.0, polar = s % 2 == 0 ? 0.7 : 0.4;
      const Eigen::Vector3d to_light(std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth),
                                     -std::cos(polar));
      lights.push_back({NearLight{kMiddle + distance_mm * to_light, {}}, {}});
      lights.back().strength.fill(1000.0 * distance_mm * distance_mm);
    }
    return lights;
  }
  static inline const Eigen::Vector3d kMiddle = Eigen::Vector3d(0, 0, 600);
  std::vector<LitImage> images_;
};

TEST_F(LightsOverSphere, SevenAreExact) {
  Shine(Around(400.0));
  const PhotometricMap map = Estimate();
  EXPECT_LT(WorstAngle(map), 1e-5);
  EXPECT_EQ(map.usable(60, 48), 7);
}

TEST_F(LightsOverSphere, AFarLightIsANearOneAtGreatDistance) {
  const std::vector<PhotometricLight> near = Around(1e7);
  Shine(near);
  for (size_t s = 0; s < near.size(); ++s) {
    const Eigen::Vector3d to_light = std::get<NearLight>(near[s].place).position_mm - kMiddle;
    images_[s].light.place = FarLight{to_light.normalized()};
    images_[s].light.strength.fill(1000.0);
  }
  const PhotometricMap map = Estimate();
  EXPECT_LT(WorstAngle(map), 1e-4);
  EXPECT_NEAR(map.albedo(60, 48), kAlbedo, 1e-4);
}

TEST_F(LightsOverSphere, LobesArePartOfTheLight) {
  std::vector<PhotometricLight> lights = Around(400.0);
  for (size_t s = 0; s < lights.size(); ++s) {
    auto& near = std::get<NearLight>(lights[s].place);
    const Eigen::Vector3d aside = kMiddle + Eigen::Vector3d(s % 2 == 0 ? 150.0 : -150.0, 0.0, 0.0);
    near.lobe = LambertianLobe((aside - near.position_mm).normalized(), 1.0 + static_cast<double>(s % 3));
  }
  Shine(lights);
  EXPECT_LT(WorstAngle(Estimate()), 1e-5);
  for (LitImage& image : images_) std::get<NearLight>(image.light.place).lobe = {};
  EXPECT_GT(WorstAngle(Estimate()), 0.05);
}

TEST_F(LightsOverSphere, CapturedVarianceIsWeight) {
  // One of seven lights is noise alone and says so.
  Shine(Around(400.0));
  Random random(8);
  Image<float> variance(truth_.width(), truth_.height(), 1, 100.0F * 100.0F);
  for (float& value : direct_[2].pixels()) value = std::abs(value + 100.0F * static_cast<float>(random.Normal()));
  const double deaf = WorstAngle(Estimate());
  images_[2].variance = variance;
  EXPECT_LT(WorstAngle(Estimate()), 0.03);
  EXPECT_LT(WorstAngle(Estimate()), 0.5 * deaf);
}

TEST_F(LightsOverSphere, SameBitsWhateverTheThreads) {
  Shine(Around(400.0));
  Random random(9);
  for (Image<float>& image : direct_)
    for (float& value : image.pixels()) value *= static_cast<float>(1.0 + 0.2 * random.Normal());
  std::vector<PhotometricMap> maps;
  for (const char* threads : {"1", "3"}) {
    setenv("STRATALUX_THREADS", threads, 1);
    maps.push_back(Estimate());
  }
  unsetenv("STRATALUX_THREADS");
  const auto same = [](const Image<float>& a, const Image<float>& b) {
    return std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
  };
  EXPECT_TRUE(same(maps[0].normal, maps[1].normal));
  EXPECT_TRUE(same(maps[0].albedo, maps[1].albedo));
  EXPECT_TRUE(same(maps[0].normal_sigma_rad, maps[1].normal_sigma_rad));
  EXPECT_EQ(maps[0].counts, maps[1].counts);
  EXPECT_EQ(maps[0].masked_negative, maps[1].masked_negative);
}

// Two projectors fix no normal: the surface's stands, and nothing is added to it.
TEST_F(LightsOverSphere, FewerThanThreeLeaveTheSurfacesNormal) {
  for (const size_t lights : {size_t{1}, size_t{2}}) {
    Shine(Around(400.0));
    images_.resize(lights);
    const PhotometricMap map = Estimate();
    int64_t on_surface = 0;
    for (int j = 0; j < truth_.height(); ++j)
      for (int i = 0; i < truth_.width(); ++i) {
        const bool there = truth_.mask(i, j) != 0;
        on_surface += there;
        ASSERT_EQ(map.reason(i, j),
                  static_cast<uint8_t>(there ? PhotometricReason::kTooFewSources : PhotometricReason::kNoSurface));
        if (!there) continue;
        const Eigen::Vector3d n(map.normal(i, j, 0), map.normal(i, j, 1), map.normal(i, j, 2));
        ASSERT_LT(n.cross(truth_.Normal(i, j)).norm(), 1e-3) << i << ", " << j;
      }
    EXPECT_EQ(map.counts[static_cast<size_t>(PhotometricReason::kTooFewSources)], on_surface);
    const SurfaceMap blurred = Blurred(2.0F);
    const auto fused = FuseNormals(blurred, map);
    ASSERT_TRUE(fused.ok());
    EXPECT_EQ(std::memcmp(fused->data(), blurred.normal.data(), fused->size() * sizeof(float)), 0);
  }
}

TEST_F(LightsOverSphere, RefuseWhatDoesNotFit) {
  Shine(Around(400.0));
  const auto code = [&] { return EstimateNormals(images_, truth_).status().code(); };
  const std::vector<LitImage> good = images_;
  images_.clear();
  EXPECT_EQ(code(), StatusCode::kUsage);
  images_ = good;
  const Image<float> small(4, 4);
  images_[1].variance = small;
  EXPECT_EQ(code(), StatusCode::kUsage);
  images_ = good;
  images_[1].light.strength[0] = -1.0;
  EXPECT_EQ(code(), StatusCode::kUsage);
  images_ = good;
  images_[1].light.place = FarLight{{0, 0, -2}};
  EXPECT_EQ(code(), StatusCode::kUsage);
}

// A wrong light gain tilts all photometric normals smoothly, scattered light makes waves of theirs that the surface
// would see: its word stands. A ripple finer than it resolves is added.
TEST_F(LambertSphere, FusionTakesFromLightWhatTheSurfaceDoesNotResolve) {
  const auto fused = [&](double period_px, float smoothing_quads) {
    PhotometricMap map = Estimate(rig_);
    for (int j = 0; j < truth_.height(); ++j)
      for (int i = 0; i < truth_.width(); ++i) {
        if (map.reason(i, j) != 0) continue;
        Eigen::Vector3d n =
            truth_.Normal(i, j) + Eigen::Vector3d(0.08 + 0.05 * std::cos(2.0 * M_PI * i / period_px), 0, 0);
        n.normalize();
        for (int k = 0; k < 3; ++k) map.normal(i, j, k) = static_cast<float>(n[k]);
      }
    const auto normal = FuseNormals(Blurred(smoothing_quads), map);
    EXPECT_TRUE(normal.ok());
    std::vector<double> added;
    for (int i = 50; i < 70; ++i) added.push_back((*normal)(i, 48, 0) - truth_.normal(i, 48, 0));
    return added;
  };
  for (const float smoothing_quads : {6.0F, 1.5F}) {
    const std::vector<double> fine = fused(4.0, smoothing_quads);
    for (int i = 50; i < 70; ++i)
      EXPECT_NEAR(fine[i - 50], 0.05 * std::cos(2.0 * M_PI * i / 4.0), 0.01) << i << ", blurred by " << smoothing_quads;
  }
  for (const double coarse : fused(24.0, 1.5F)) EXPECT_LT(std::abs(coarse), 0.006) << "what the surface resolves";
  EXPECT_GT(std::ranges::max(fused(24.0, 8.0F)), 0.03) << "by a surface that does not";
  for (const double nothing : fused(4.0, 0.0F)) EXPECT_EQ(nothing, 0.0) << "it says of no blur";
}

TEST_F(LambertSphere, FusionDoesNotAddNoiseToAGoodSurface) {
  Random random(5);
  for (Image<float>& image : direct_)
    for (float& value : image.pixels()) value *= static_cast<float>(1.0 + 0.03 * random.Normal());
  const PhotometricMap map = Estimate(rig_);
  const auto fused = FuseNormals(Blurred(6.0F), map);
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
  const PhotometricMap map = Estimate(rig_, {.relative_sigma = 0.009});  // of the brightest: most sources are darker
  double normalised = 0.0;
  for (int j = 38; j < 58; ++j)
    for (int i = 50; i < 70; ++i) {
      ASSERT_EQ(map.usable(i, j), 4);
      double error = 0.0;
      for (int k = 0; k < 3; ++k) error += std::pow(map.normal(i, j, k) - truth_.normal(i, j, k), 2);
      normalised += error / std::pow(map.normal_sigma_rad(i, j), 2) / 400.0;
    }
  EXPECT_NEAR(std::sqrt(normalised), 1.0, 0.15);
}

// What a blur leaves of white noise when it is taken off.
TEST(GaussianTaps, AddUpToOneAndTellTheNoiseAboveTheBlur) {
  for (const double sigma : {0.5, 1.0, 1.5, 6.0}) {
    const std::vector<float> taps = GaussianTaps(sigma);
    EXPECT_NEAR(std::accumulate(taps.begin(), taps.end(), 0.0), 1.0, 1e-6);
    Random random(7);
    Image<float> noise(200, 200);
    for (float& value : noise.pixels()) value = static_cast<float>(random.Normal());
    const Image<float> blurred = GaussianBlur(noise, sigma);
    double variance = 0.0;
    for (int y = 20; y < 180; ++y)
      for (int x = 20; x < 180; ++x) variance += std::pow(noise(x, y) - blurred(x, y), 2) / (160.0 * 160.0);
    EXPECT_NEAR(NoiseAboveBlur(sigma), variance, 0.03) << sigma;
  }
  EXPECT_LT(NoiseAboveBlur(1.0), 0.8);
}

TEST_F(LambertSphere, FusionDoesNotAddTheNoiseOfThreeSources) {
  direct_.pop_back();
  rig_.projectors.pop_back();
  Random random(5);
  for (Image<float>& image : direct_)
    for (float& value : image.pixels()) value *= static_cast<float>(1.0 + 0.03 * random.Normal());
  const PhotometricMap map = Estimate(rig_);
  const auto fused = FuseNormals(Blurred(6.0F), map);
  ASSERT_TRUE(fused.ok());
  double photometric = 0.0, after = 0.0;
  for (int j = 38; j < 58; ++j)
    for (int i = 50; i < 70; ++i) {
      ASSERT_EQ(map.usable(i, j), 3);
      for (int k = 0; k < 3; ++k) {
        photometric += std::pow(map.normal(i, j, k) - truth_.normal(i, j, k), 2);
        after += std::pow((*fused)(i, j, k) - truth_.normal(i, j, k), 2);
      }
    }
  EXPECT_LT(after, 0.1 * photometric);
}

}  // namespace
}  // namespace stratalux::fit
