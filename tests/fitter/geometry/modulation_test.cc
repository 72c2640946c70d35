// SPDX-License-Identifier: Apache-2.0
#include "fitter/separation/modulation.h"

#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

constexpr int kSeenWidth = 96, kSeenHeight = 64, kSeenShifts = 4;
constexpr double kSeenBlack_dn = 100.0, kSeenMean_dn = 1200.0;  // the latter above black
constexpr SensorNoise kSeenNoise{
    .black_level_dn = 60.0, .saturation_dn = 4095.0, .gain_e_per_dn = 4.0, .read_noise_dn = 3.0};

// Sinusoids that are seen with `modulation`, and camera noise.
struct SeenSinusoids {
  explicit SeenSinusoids(double modulation, double mean_dn = kSeenMean_dn)
      : black(kSeenWidth, kSeenHeight, 1, kSeenBlack_dn) {
    Random random(7);
    for (int k = 0; k < kSeenShifts; ++k) {
      Image<uint16_t>& image = images.emplace_back(kSeenWidth, kSeenHeight);
      for (size_t i = 0; i < image.size(); ++i) {
        const double phase = 0.37 * static_cast<double>(i % kSeenWidth);
        const double light_dn =
            kSeenBlack_dn + mean_dn * (1.0 + modulation * std::cos(phase - 2.0 * std::numbers::pi * k / kSeenShifts));
        // Twelve uniform numbers have a standard deviation of 1.
        double noise = -6.0;
        for (int n = 0; n < 12; ++n) noise += static_cast<double>(random.Bits() >> 11) * 0x1p-53;
        image.data()[i] =
            static_cast<uint16_t>(std::lround(light_dn + noise * std::sqrt(kSeenNoise.VarianceDn2(light_dn))));
      }
    }
  }
  [[nodiscard]] Modulation Measure() const {
    const std::vector<ImageView<const uint16_t>> shifts(images.begin(), images.end());
    auto measured = MeasureModulation({.black = black, .shifts = shifts}, kSeenNoise);
    EXPECT_TRUE(measured.ok()) << measured.status().message();
    return std::move(measured).value();
  }
  Image<float> black;
  std::vector<Image<uint16_t>> images;
};

constexpr Region kSeenAll{0, 0, kSeenWidth, kSeenHeight};

int64_t CountOfReason(const Modulation& modulation, ModulationReason reason) {
  return modulation.counts[static_cast<size_t>(reason)];
}

TEST(MeasureModulation, IsTheContrastThatIsSeen) {
  for (const double modulation : {0.2, 0.5, 0.9}) {
    const SiteMedian median = MedianIn(SeenSinusoids(modulation).Measure().value, kSeenAll);
    ASSERT_TRUE(median.value);
    EXPECT_EQ(median.sites, kSeenWidth * kSeenHeight);
    EXPECT_NEAR(*median.value, modulation, 0.002);
  }
}

TEST(MeasureModulation, RatiosAreOfTheSiteAndOfTheRegion) {
  const Modulation fine = SeenSinusoids(0.3).Measure(), coarse = SeenSinusoids(0.6).Measure();
  Image<float> half = fine.value;
  for (int y = 0; y < kSeenHeight; ++y)
    for (int x = 0; x < kSeenWidth / 2; ++x) half(x, y) = coarse.value(x, y);
  EXPECT_NEAR(MedianRatioIn(half, coarse.value, {kSeenWidth / 2, 0, kSeenWidth / 2, kSeenHeight}).value.value_or(0.0),
              0.5, 0.005);
  EXPECT_NEAR(MedianRatioIn(half, coarse.value, {0, 0, kSeenWidth / 2, kSeenHeight}).value.value_or(0.0), 1.0, 1e-6);
}

TEST(MeasureModulation, WhatSaturatesIsUnlitOrHasNoBlackIsMaskedAndCounted) {
  SeenSinusoids scene(0.5);
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 10; ++x) scene.images[2](x, y) = 4095;
  for (int x = 20; x < 25; ++x)
    for (Image<uint16_t>& image : scene.images) image(x, 0) = static_cast<uint16_t>(kSeenBlack_dn);
  scene.black(30, 0) = std::nanf("");
  const Modulation modulation = scene.Measure();
  EXPECT_EQ(CountOfReason(modulation, ModulationReason::kSaturated), 80);
  EXPECT_EQ(CountOfReason(modulation, ModulationReason::kUnlit), 5);
  EXPECT_EQ(CountOfReason(modulation, ModulationReason::kNotFinite), 1);
  EXPECT_EQ(CountOfReason(modulation, ModulationReason::kValid), kSeenWidth * kSeenHeight - 86);
  const SiteMedian masked = MedianIn(modulation.value, {0, 0, 10, 8});
  EXPECT_EQ(masked.sites, 0);
  EXPECT_FALSE(masked.value);
  EXPECT_NEAR(MedianIn(modulation.value, kSeenAll).value.value_or(0.0), 0.5, 0.002);
}

TEST(MeasureModulation, RefusesTwoShiftsAndOtherSizes) {
  SeenSinusoids scene(0.5);
  scene.images.resize(2);
  std::vector<ImageView<const uint16_t>> shifts(scene.images.begin(), scene.images.end());
  EXPECT_EQ(MeasureModulation({.black = scene.black, .shifts = shifts}, kSeenNoise).status().code(),
            StatusCode::kUsage);
  const Image<uint16_t> small(kSeenWidth, kSeenHeight / 2);
  shifts.push_back(small);
  EXPECT_EQ(MeasureModulation({.black = scene.black, .shifts = shifts}, kSeenNoise).status().code(),
            StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::fit
