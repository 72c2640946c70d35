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

constexpr int kSide = 24;
const std::vector<int> kProjectors = {0, 1, 2};

struct Face {
  std::vector<SrdBatch> batches;
  EmOptions options;
  [[nodiscard]] std::vector<const SrdBatch*> lights() const {
    std::vector<const SrdBatch*> list;
    for (const SrdBatch& b : batches) list.push_back(&b);
    return list;
  }
  [[nodiscard]] SurfaceOffset Estimate() const {
    const auto offset = EstimateOffset(lights(), kProjectors, kSide, 1, 5.0, options);
    EXPECT_TRUE(offset.ok()) << offset.status().message();
    return *offset;
  }
};

// kSide x kSide pixels of one skin, a fifth off in all layers, and its surface's light, read on a surface that lies
// `too_deep` mm behind the true one.
Face MakeFace(double too_deep, double peak_counts, uint64_t seed, std::vector<double> slopes = {-1.0, 0.0, 0.58}) {
  Face face;
  face.options.scattering.gain_model = false;
  face.options.scattering.reflection = {1.0, 0.35};
  EmCases made =
      MakeEmCases({.profiles = kSide * kSide, .alike = kSide * kSide, .slopes = std::move(slopes)}, face.options, seed);
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
        b.Variances(i)[k] = static_cast<float>(variance);
      }
    }
    MoveSurface(b, too_deep);
    face.batches.push_back(std::move(b));
  }
  return face;
}

TEST(SurfaceOffset, IsFoundWhateverItIs) {
  for (const double too_deep : {0.1, 0.0, -0.15, 0.25}) {
    const SurfaceOffset offset = MakeFace(too_deep, 2000.0, 51).Estimate();
    EXPECT_FALSE(offset.at_bound);
    EXPECT_NEAR(offset.depth_mm, -too_deep, 0.02);
    EXPECT_NEAR(offset.depth_mm, -too_deep, 4.0 * offset.sigma_mm + 0.003);
    EXPECT_LT(offset.sigma_mm, 0.02);
  }
}

TEST(SurfaceOffset, SaysHowLittleFewPhotonsTell) {
  std::vector<double> dim, sigmas;
  for (uint64_t seed = 60; seed < 70; ++seed) {
    const SurfaceOffset offset = MakeFace(0.1, 60.0, seed).Estimate();
    dim.push_back((offset.depth_mm + 0.1) / offset.sigma_mm);
    sigmas.push_back(offset.sigma_mm);
  }
  double squares = 0.0;
  for (const double z : dim) squares += z * z / static_cast<double>(dim.size());
  EXPECT_LT(squares, 6.0);  // a skin's own bias comes on top of the photons' noise
  EXPECT_GT(squares, 0.1);
  const double bright = MakeFace(0.1, 6000.0, 60).Estimate().sigma_mm;
  EXPECT_GT(*std::min_element(sigmas.begin(), sigmas.end()), 2.0 * bright);
}

TEST(SurfaceOffset, TooFarIsSaid) { EXPECT_TRUE(MakeFace(1.0, 2000.0, 57).Estimate().at_bound); }

TEST(SurfaceOffset, ADirectionBlindFitFindsAnother) {
  // Its layers have no depth: where light leaves displaced, the surface must be.
  Face face = MakeFace(0.0, 2000.0, 54);
  const double seeing = face.Estimate().depth_mm;
  face.options.direction_blind = true;
  const SurfaceOffset blind = face.Estimate();
  EXPECT_GT(std::abs(blind.depth_mm - seeing), 0.03);
}

TEST(SurfaceOffset, IsNothingWhereOneProjectorAloneLights) {
  const Face face = MakeFace(0.1, 2000.0, 55);
  const auto offset = EstimateOffset(face.lights(), {2, 2, 2}, kSide, 1, 5.0, face.options);
  ASSERT_TRUE(offset.ok());
  EXPECT_EQ(offset->pixels, 0);
  EXPECT_EQ(offset->depth_mm, 0.0);
}

TEST(SurfaceOffset, IsTheSameForAnyNumberOfThreads) {
  const Face face = MakeFace(0.1, 500.0, 56);
  setenv("STRATALUX_THREADS", "1", 1);
  const SurfaceOffset one = face.Estimate();
  setenv("STRATALUX_THREADS", "3", 1);
  const SurfaceOffset three = face.Estimate();
  unsetenv("STRATALUX_THREADS");
  EXPECT_EQ(one.depth_mm, three.depth_mm);
  EXPECT_EQ(one.sigma_mm, three.sigma_mm);
}

}  // namespace
}  // namespace stratalux::fit
