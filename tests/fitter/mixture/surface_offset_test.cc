// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/surface_offset.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include <gtest/gtest.h>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/surface_reflection.h"
#include "tests/fitter/mixture/em_cases.h"

namespace stratalux::fit {
namespace {

constexpr int kFaceSide = 24;
const std::vector<int> kProjectors = {0, 1, 2};
// Differs from pixel to pixel.
const std::vector<float> kDisplacement = [] {
  std::vector<float> of_pixels;
  for (int i = 0; i < kFaceSide * kFaceSide; ++i) of_pixels.push_back(0.4F + 0.01F * static_cast<float>(i % 30));
  return of_pixels;
}();

struct Face {
  std::vector<SrdBatch> batches;
  EmOptions options;
  [[nodiscard]] std::vector<const SrdBatch*> lights() const {
    std::vector<const SrdBatch*> list;
    for (const SrdBatch& b : batches) list.push_back(&b);
    return list;
  }
  [[nodiscard]] SurfaceOffset Estimate(double mm_per_pixel = 5.0) const {
    const auto offset = EstimateOffset(lights(), kProjectors, kFaceSide, 1, mm_per_pixel, kDisplacement, options);
    EXPECT_TRUE(offset.ok()) << offset.status().message();
    return *offset;
  }
};

// kFaceSide x kFaceSide pixels of one skin, a fifth off in all layers, and its surface's light, read on a surface that
// lies too deep by `depth` of kDisplacement.
Face MakeFace(double depth, double peak_counts, uint64_t seed, std::vector<double> slopes = {-1.0, 0.0, 0.58}) {
  Face face;
  face.options.scattering.gain_model = false;
  face.options.scattering.reflection = {1.0, 0.35};
  EmCases made =
      MakeEmCases({.profiles = kFaceSide * kFaceSide, .alike = kFaceSide * kFaceSide, .slopes = std::move(slopes)},
                  face.options, seed);
  Random random(seed + 1);
  for (SrdBatch& b : made.batches) {
    for (int64_t i = 0; i < b.profiles(); ++i) {
      LayerSet skin = made.skins[i];
      skin.weight.push_back(
          ReflectanceOf(face.options.scattering.reflection, ReflectionAngles::Of(b, i), face.options.scattering.eta));
      skin.depth_mm.push_back(0.0);
      skin.sigma_mm.push_back(0.005);
      const auto y = PredictSamples(skin, b, i, face.options.scattering);
      const double counts = peak_counts / *std::max_element(y.begin(), y.end());
      for (int k = 0; k < b.samples; ++k) {
        const double variance = (y[k] + 2e-5) / counts;
        b.Samples(i)[k] = static_cast<float>(y[k] + random.Normal() * std::sqrt(variance));
      }
      b.noise_floor[i] = static_cast<float>(2e-5 / counts);
      b.noise_slope[i] = static_cast<float>(1.0 / counts);
    }
    MoveSurface(b, 1, kDisplacement, depth);
    face.batches.push_back(std::move(b));
  }
  return face;
}

TEST(SurfaceOffset, IsFoundWhateverItIs) {
  for (const double depth : {0.2, 0.0, -0.3, 0.5}) {
    const SurfaceOffset offset = MakeFace(depth, 2000.0, 51).Estimate();
    EXPECT_FALSE(offset.at_bound);
    EXPECT_NEAR(offset.code_depth_mm, depth, 0.04);
    EXPECT_NEAR(offset.code_depth_mm, depth, 4.0 * offset.sigma_mm + 0.006);
    EXPECT_LT(offset.sigma_mm, 0.04);
  }
}

// Of 12 mm: less than one of the parts that a face's error is told by.
TEST(SurfaceOffset, IsFoundOfSomethingSmallToo) {
  const Face sample = MakeFace(0.2, 2000.0, 51);
  const SurfaceOffset offset = sample.Estimate(0.5);
  EXPECT_EQ(offset.pixels, kFaceSide * kFaceSide);
  EXPECT_NEAR(offset.code_depth_mm, 0.2, 0.04);
  EXPECT_GT(offset.sigma_mm, 0.0);
  EXPECT_LT(offset.sigma_mm, 0.04);
}

TEST(SurfaceOffset, SaysHowLittleFewPhotonsTell) {
  double squares = 0.0, least = 1.0;
  constexpr int kFaces = 10;
  for (uint64_t seed = 60; seed < 60 + kFaces; ++seed) {
    const SurfaceOffset offset = MakeFace(0.2, 60.0, seed).Estimate();
    squares += std::pow((offset.code_depth_mm - 0.2) / offset.sigma_mm, 2) / kFaces;
    least = std::min(least, offset.sigma_mm);
  }
  EXPECT_LT(squares, 6.0);  // a skin's own bias comes on top of the photons' noise
  EXPECT_GT(squares, 0.1);
  EXPECT_GT(least, 2.0 * MakeFace(0.2, 6000.0, 60).Estimate().sigma_mm);
}

TEST(SurfaceOffset, TooFarIsSaidAndMovesNothing) {
  const SurfaceOffset offset = MakeFace(2.0, 2000.0, 57).Estimate();
  EXPECT_TRUE(offset.at_bound);
  EXPECT_EQ(offset.code_depth_mm, 0.0);
}

TEST(SurfaceOffset, ADirectionBlindFitFindsAnother) {
  // Its layers have no depth: where light leaves displaced, the surface must be.
  Face face = MakeFace(0.0, 2000.0, 54);
  const double seeing = face.Estimate().code_depth_mm;
  face.options.direction_blind = true;
  EXPECT_GT(std::abs(face.Estimate().code_depth_mm - seeing), 0.06);
}

TEST(SurfaceOffset, IsNothingWhereOneProjectorAloneLights) {
  const Face face = MakeFace(0.2, 2000.0, 55);
  const auto offset = EstimateOffset(face.lights(), {2, 2, 2}, kFaceSide, 1, 5.0, kDisplacement, face.options);
  ASSERT_TRUE(offset.ok());
  EXPECT_EQ(offset->pixels, 0);
  EXPECT_EQ(offset->code_depth_mm, 0.0);
}

TEST(SurfaceOffset, IsTheSameForAnyNumberOfThreads) {
  const Face face = MakeFace(0.2, 500.0, 56);
  setenv("STRATALUX_THREADS", "1", 1);
  const SurfaceOffset one = face.Estimate();
  setenv("STRATALUX_THREADS", "3", 1);
  const SurfaceOffset three = face.Estimate();
  unsetenv("STRATALUX_THREADS");
  EXPECT_EQ(one.code_depth_mm, three.code_depth_mm);
  EXPECT_EQ(one.sigma_mm, three.sigma_mm);
}

}  // namespace
}  // namespace stratalux::fit
