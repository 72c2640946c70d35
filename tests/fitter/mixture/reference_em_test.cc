// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/mixture/reference_em.h"

#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "tests/fitter/mixture/known_lights.h"

namespace stratalux::fit {
namespace {

constexpr double kSlopes[] = {-1.0, 0.0, 0.577};

EmOptions Options() {
  EmOptions options;
  options.surface_term = false;
  options.scattering.gain_model = false;
  options.layers = 12;
  options.max_iterations = 50;
  return options;
}

std::vector<SrdBatch> Combs(const EmOptions& options, uint64_t seed, double peak_counts = 4000.0) {
  Random random(seed);
  std::vector<SrdBatch> combs;
  for (double slope : kSlopes)
    combs.push_back(test::CombOf(test::FiveLayers(), slope, 1, peak_counts, options, random));
  return combs;
}

std::vector<ProfileLight> LightsOf(const std::vector<SrdBatch>& combs, const EmOptions& options) {
  std::vector<ProfileLight> lights;
  for (const SrdBatch& b : combs) lights.push_back(ProfileLightOf(b, 0, options));
  return lights;
}

double Total(const LayerSet& layers) { return std::accumulate(layers.weight.begin(), layers.weight.end(), 0.0); }
double MeanDepth(const LayerSet& layers) {
  return std::inner_product(layers.weight.begin(), layers.weight.end(), layers.depth_mm.begin(), 0.0) / Total(layers);
}

TEST(ReferenceEm, KnownLayersUnderPhotonNoise) {
  // Root mean squares over noise realisations: albedo, depth, and light from a side never fitted. The photons of one
  // profile bound its depth to 3 % (standard_errors); no single realisation can promise 4.
  const EmOptions options = Options();
  constexpr int kSeeds = 24;
  Random random(99);
  const SrdBatch unseen = test::CombOf(test::FiveLayers(), 1.0, 1, 0.0, options, random);
  const auto truth = PredictSamples(test::FiveLayers(), unseen, 0, options.scattering);
  double weight = 0.0, depth = 0.0, error = 0.0, power = 0.0;
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const auto lights = LightsOf(Combs(options, seed), options);
    const ProfileFit fit = FitReference(lights, SpreadLayers(lights, options), options);
    weight += std::pow(Total(fit.layers) / Total(test::FiveLayers()) - 1.0, 2) / kSeeds;
    depth += std::pow(MeanDepth(fit.layers) / MeanDepth(test::FiveLayers()) - 1.0, 2) / kSeeds;
    const auto predicted = PredictSamples(fit.layers, unseen, 0, options.scattering);
    for (size_t k = 0; k < truth.size(); ++k) {
      error += std::pow(predicted[k] + fit.background[0] - truth[k], 2);
      power += truth[k] * truth[k];
    }
  }
  EXPECT_LT(std::sqrt(weight), 0.01);
  EXPECT_LT(std::sqrt(depth), 0.04);
  EXPECT_LT(std::sqrt(error / power), 0.015);
}

TEST(ReferenceEm, DivergenceNeverRises) {
  EmOptions options = Options();
  const auto lights = LightsOf(Combs(options, 3), options);
  const LayerSet start = SpreadLayers(lights, options);
  options.tolerance = 0.0;
  double last = 1e300;
  for (int sweeps : {1, 2, 3, 5, 9, 17, 33}) {
    options.max_iterations = sweeps;
    const double now = FitReference(lights, start, options).divergence;
    EXPECT_LE(now, last * (1.0 + 1e-9)) << sweeps;
    last = now;
  }
}

TEST(ReferenceEm, ModelledLightAddsUpToTheMeasured) {
  // A fixed point of EM: with the weights at their maximum the photons of model and data agree.
  EmOptions options = Options();
  options.max_iterations = 100;
  const auto lights = LightsOf(Combs(options, 5), options);
  const ProfileFit fit = FitReference(lights, SpreadLayers(lights, options), options);
  double data = 0.0, model = 0.0;
  for (size_t p = 0; p < lights.size(); ++p) {
    const auto y = ModelOf(fit, FineGrid(lights[p]), p);
    data += lights[p].counts * std::accumulate(lights[p].y.begin(), lights[p].y.end(), 0.0);
    model += lights[p].counts * std::accumulate(y.begin(), y.end(), 0.0);
  }
  EXPECT_NEAR(model / data, 1.0, 1e-3);
}

TEST(ReferenceEm, EmptyAndNegativeSamplesGiveFiniteLayers) {
  const EmOptions options = Options();
  auto combs = Combs(options, 1);
  for (double scale : {0.0, -1.0}) {
    for (SrdBatch& b : combs)
      for (float& y : b.y) y = static_cast<float>(scale) * std::abs(y);
    const auto lights = LightsOf(combs, options);
    const ProfileFit fit = FitReference(lights, SpreadLayers(lights, options), options);
    for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
      EXPECT_TRUE(std::isfinite(fit.layers.weight[l]) && fit.layers.weight[l] >= 0.0);
      EXPECT_TRUE(std::isfinite(fit.layers.depth_mm[l]) && std::isfinite(fit.layers.sigma_mm[l]));
    }
    EXPECT_TRUE(std::isfinite(fit.divergence));
  }
}

}  // namespace
}  // namespace stratalux::fit
