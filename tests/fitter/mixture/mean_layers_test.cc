// SPDX-License-Identifier: Apache-2.0
// The layers of many profiles together: what they share is found whatever the noise, and each keeps its brightness.
#include "fitter/mixture/mean_layers.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numeric>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "fitter/mixture/fit_mixture.h"
#include "tests/fitter/mixture/em_cases.h"

namespace stratalux::fit {
namespace {

constexpr int kMany = 256;
const std::vector<int> kThree = {0, 1, 2};

double Total(const LayerSet& set) { return std::accumulate(set.weight.begin(), set.weight.end(), 0.0); }

double MeanDepth(const LayerSet& set) {
  return std::inner_product(set.weight.begin(), set.weight.end(), set.depth_mm.begin(), 0.0) / Total(set);
}

double EffectiveWidth(const LayerSet& set) {
  double square = 0.0;
  for (size_t l = 0; l < set.weight.size(); ++l) square += set.weight[l] * set.sigma_mm[l] * set.sigma_mm[l];
  return std::sqrt(square / Total(set));
}

// The same skin everywhere.
EmCases OneSkin(double peak_counts, uint64_t seed) {
  return MakeEmCases(
      {.profiles = kMany, .peak_counts = peak_counts, .read_photons = 25.0, .alike = kMany, .unlike = 0.0}, {}, seed);
}

EmOptions WithoutSurface() {
  EmOptions options;
  options.surface_term = false;  // these skins have none
  return options;
}

LayerSet MeanOf(const EmCases& made, const EmOptions& options = WithoutSurface()) {
  const auto mean = MeanLayers(made.lights(), 1, options);
  EXPECT_TRUE(mean.ok()) << mean.status().message();
  return mean->at(0);
}

// Each profile fitted alone, and its layers' effective numbers averaged.
std::pair<double, double> DepthAndWidthOfSingleFits(const EmCases& made) {
  const auto map = FitMixture(made.lights(), kThree, kMany, 1, 1, WithoutSurface());
  EXPECT_TRUE(map.ok());
  double depth = 0.0, width = 0.0;
  for (int i = 0; i < kMany; ++i) {
    depth += MeanDepth(LayersOf(*map, i)) / kMany;
    width += EffectiveWidth(LayersOf(*map, i)) / kMany;
  }
  return {depth, width};
}

TEST(MeanLayers, FindDepthAndWidthThatNoiseHidesFromSingleProfiles) {
  double worst_single = 0.0;
  for (const uint64_t seed : {51, 52, 53})
    for (const double counts : {200.0, 1000.0, 4000.0}) {
      const EmCases made = OneSkin(counts, seed);
      const LayerSet mean = MeanOf(made), truth = made.skins[0];
      const auto [depth, width] = DepthAndWidthOfSingleFits(made);
      std::printf("seed %d, %4.0f counts: depth %.4f of %.4f (single fits %.4f), width %.4f of %.4f (%.4f)\n",
                  static_cast<int>(seed), counts, MeanDepth(mean), MeanDepth(truth), depth, EffectiveWidth(mean),
                  EffectiveWidth(truth), width);
      EXPECT_NEAR(MeanDepth(mean), MeanDepth(truth), 0.05 * MeanDepth(truth)) << counts;
      EXPECT_NEAR(EffectiveWidth(mean), EffectiveWidth(truth), 0.02 * EffectiveWidth(truth)) << counts;
      EXPECT_NEAR(Total(mean), Total(truth), 0.02 * Total(truth)) << counts;
      worst_single = std::max(worst_single, std::abs(depth / MeanDepth(truth) - 1.0));
    }
  EXPECT_GT(worst_single, 0.1);
}

TEST(MeanLayers, LeaveEachProfileItsBrightness) {
  const EmCases even = OneSkin(1000.0, 54);
  EmCases uneven = even;
  double mean_brightness = 0.0;
  for (int i = 0; i < kMany; ++i) {
    const auto times = static_cast<float>(i % 2 == 0 ? 0.25 : 4.0);
    mean_brightness += double{times} / kMany;
    for (SrdBatch& light : uneven.batches) {
      for (float& y : light.Samples(i)) y *= times;
      light.noise_floor[i] *= times * times;
      light.noise_slope[i] *= times;
    }
  }
  const LayerSet as_they_are = MeanOf(even), scaled = MeanOf(uneven);
  EXPECT_NEAR(MeanDepth(scaled), MeanDepth(as_they_are), 1e-3);
  EXPECT_NEAR(EffectiveWidth(scaled), EffectiveWidth(as_they_are), 1e-3);
  EXPECT_NEAR(Total(scaled), mean_brightness * Total(as_they_are), 1e-3);
}

TEST(MeanLayers, AreNotThoseOfWhoeverHasTheMostPhotons) {
  // Two skins, one of them seen with a hundred times the photons.
  EmCases made = OneSkin(2e4, 55);
  const EmCases other = OneSkin(2e6, 56);
  for (size_t p = 0; p < made.batches.size(); ++p)
    for (int i = 0; i < kMany; i += 2) {
      SrdBatch& light = made.batches[p];
      const SrdBatch& from = other.batches[p];
      std::ranges::copy(from.Samples(i), light.Samples(i).begin());
      for (const auto of : {&SrdBatch::noise_floor, &SrdBatch::noise_slope, &SrdBatch::step_mm,
                            &SrdBatch::line_width_mm, &SrdBatch::blur_mm, &SrdBatch::first_u_mm, &SrdBatch::slope_in,
                            &SrdBatch::slope_out, &SrdBatch::cos_in, &SrdBatch::cos_out})
        (light.*of)[i] = (from.*of)[i];
    }
  const double one = std::pow(EffectiveWidth(made.skins[0]), 2), two = std::pow(EffectiveWidth(other.skins[0]), 2),
               both = std::pow(EffectiveWidth(MeanOf(made)), 2);
  // What is averaged are shares of light, so squares of widths.
  EXPECT_NEAR((both - two) / (one - two), 0.5, 0.15);
}

TEST(MeanLayers, AreTheSameForAnyNumberOfThreadsAndEmptyWithoutLight) {
  EmCases made = OneSkin(200.0, 57);
  setenv("STRATALUX_THREADS", "1", 1);
  const LayerSet one = MeanOf(made);
  setenv("STRATALUX_THREADS", "3", 1);
  const LayerSet three = MeanOf(made);
  unsetenv("STRATALUX_THREADS");
  EXPECT_EQ(one.weight, three.weight);
  EXPECT_EQ(one.depth_mm, three.depth_mm);
  EXPECT_EQ(one.sigma_mm, three.sigma_mm);
  for (SrdBatch& light : made.batches) std::ranges::fill(light.valid, 0);
  EXPECT_TRUE(MeanOf(made).weight.empty());
}

TEST(MeanLayers, FromLayersThatAreNearTakeFewerSweeps) {
  const EmCases made = OneSkin(1000.0, 59);
  EmOptions hurried = WithoutSurface();
  hurried.max_iterations = 1;  // ten sweeps
  const LayerSet settled = MeanOf(made);
  LayerSet near = settled;
  for (auto* values : {&near.depth_mm, &near.sigma_mm})
    for (double& v : *values) v *= 1.05;
  const auto from_near = MeanLayers(made.lights(), 1, hurried, kPixelsOfMean, {&near, 1});
  ASSERT_TRUE(from_near.ok());
  const auto off = [&](const LayerSet& set) {
    return std::abs(MeanDepth(set) / MeanDepth(settled) - 1.0) +
           std::abs(EffectiveWidth(set) / EffectiveWidth(settled) - 1.0);
  };
  std::printf("off by %.4f, from the usual start %.4f, at the start %.4f\n", off(from_near->at(0)),
              off(MeanOf(made, hurried)), off(near));
  EXPECT_LT(off(from_near->at(0)), 0.5 * off(near));
  EXPECT_LT(off(from_near->at(0)), 0.5 * off(MeanOf(made, hurried)));
  // A colour that nothing is known of has the usual start.
  const LayerSet unknown;
  const auto from_nothing = MeanLayers(made.lights(), 1, hurried, kPixelsOfMean, {&unknown, 1});
  ASSERT_TRUE(from_nothing.ok());
  EXPECT_EQ(from_nothing->at(0).sigma_mm, MeanOf(made, hurried).sigma_mm);
}

TEST(MeanLayers, HoldTheDepthOfTheBlindAtNothing) {
  EmOptions options = WithoutSurface();
  options.direction_blind = true;
  for (const double depth : MeanOf(OneSkin(400.0, 58), options).depth_mm) EXPECT_EQ(depth, 0.0);
}

}  // namespace
}  // namespace stratalux::fit
