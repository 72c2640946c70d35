// SPDX-License-Identifier: Apache-2.0
// The production EM against the reference, against itself in other company, and against plain EM.
#include <algorithm>
#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "fitter/mixture/fit_mixture.h"
#include "tests/fitter/mixture/em_cases.h"
#include "tests/fitter/mixture/reference_em.h"
#include "tests/fitter/mixture/simd_targets.h"

namespace stratalux::fit {
namespace {

MixtureMap Fit(const std::vector<const SrdBatch*>& lights, const EmOptions& options,
               const std::vector<LayerSet>& start = {}) {
  std::vector<int> projectors(lights.size());
  std::iota(projectors.begin(), projectors.end(), 0);
  auto map = FitMixture(lights, projectors, static_cast<int>(lights[0]->profiles()), 1, 1, options, start);
  EXPECT_TRUE(map.ok()) << map.status().message();
  return *std::move(map);
}

ProfileFit Reference(const std::vector<const SrdBatch*>& lights, int64_t profile, const EmOptions& options) {
  std::vector<ProfileLight> all;
  for (const SrdBatch* b : lights)
    if (b->valid[profile] != 0) all.push_back(ProfileLightOf(*b, profile, options));
  return FitReference(all, SpreadLayers(all, options), options);
}

// Divergence to six decimals, every parameter of a layer that has light to 1e-3.
void ExpectAsReference(const MixtureMap& map, int64_t profile, const ProfileFit& reference) {
  EXPECT_NEAR(map.divergence[profile], reference.divergence, 1e-6);
  EXPECT_NEAR(map.divergence[profile] / reference.divergence, 1.0, 2e-4);
  const LayerSet fitted = LayersOf(map, profile);
  const double total = std::accumulate(reference.layers.weight.begin(), reference.layers.weight.end(), 0.0);
  for (size_t l = 0; l < fitted.weight.size(); ++l) {
    EXPECT_NEAR(fitted.weight[l], reference.layers.weight[l], 1e-5 * total) << l;
    if (reference.layers.weight[l] < 1e-3 * total) continue;
    EXPECT_NEAR(fitted.depth_mm[l], reference.layers.depth_mm[l], 1e-3) << l;
    EXPECT_NEAR(fitted.sigma_mm[l] / reference.layers.sigma_mm[l], 1.0, 1e-3) << l;
  }
}

EmOptions Plain(int sweeps) {
  EmOptions options;
  options.accelerated = false;
  options.tolerance = 0.0;
  options.max_iterations = sweeps;
  options.background_term = true;
  return options;
}

void ExpectAgreement(const EmCaseOptions& cases, const EmOptions& options, uint64_t seed) {
  const EmCases made = MakeEmCases(cases, options, seed);
  const auto lights = made.lights();
  const MixtureMap map = Fit(lights, options);
  for (int64_t i = 0; i < cases.profiles; ++i) {
    SCOPED_TRACE(i);
    ExpectAsReference(map, i, Reference(lights, i, options));
  }
}

TEST(EmAgreement, CombsOnEveryInstructionSet) {
  ForEachSimdTarget([](const char* name) {
    SCOPED_TRACE(name);
    ExpectAgreement({.profiles = 2, .peak_counts = 2000}, Plain(50), 11);
  });
}

TEST(EmAgreement, OpenWindows) {
  ExpectAgreement({.profiles = 2, .samples = 41, .wrapped = false, .peak_counts = 20000}, Plain(30), 12);
}

TEST(EmAgreement, AnyNumberOfSamplesOnEveryInstructionSet) {
  ForEachSimdTarget([](const char* name) {
    SCOPED_TRACE(name);
    for (const int samples : {61, 12}) ExpectAgreement({.profiles = 2, .samples = samples}, Plain(20), 21);
  });
}

// Of one profile, one after another on the same work space: a comb, a short open window, a shorter comb.
TEST(EmAgreement, LightsOfDifferentSizes) {
  const EmOptions options = Plain(30);
  const LayerSet skin = {{0.2, 0.15, 0.1}, {0.1, 0.4, 0.8}, {0.3, 0.8, 2.0}};
  const EmCases combs = MakeEmCases({.profiles = 2, .skins = {skin}}, options, 22);
  const EmCases windows = MakeEmCases({.profiles = 2, .samples = 21, .wrapped = false, .skins = {skin}}, options, 23);
  const EmCases short_combs = MakeEmCases({.profiles = 2, .samples = 29, .skins = {skin}}, options, 24);
  const std::vector<const SrdBatch*> lights = {&combs.batches[0], &windows.batches[1], &short_combs.batches[2]};
  const MixtureMap map = Fit(lights, options);
  for (int64_t i = 0; i < 2; ++i) {
    SCOPED_TRACE(i);
    ExpectAsReference(map, i, Reference(lights, i, options));
  }
}

TEST(EmAgreement, PooledQuads) { ExpectAgreement({.profiles = 2, .pool = 2}, Plain(30), 20); }

TEST(EmAgreement, FreeModeOfASingleLight) {
  EmOptions options = Plain(30);
  options.scattering.mode = FitMode::kFree;
  ExpectAgreement({.profiles = 2, .slopes = {0.7}}, options, 13);
}

TEST(EmAgreement, DirectionalWeightsWithoutSurfaceAndWithOneFloor) {
  EmOptions options = Plain(30);
  options.scattering.directional = {.kappa_per_mm = 0.4, .phase_slope = 0.5, .sigma_0_mm = 0.4};
  options.surface_term = false;
  options.shared_background = true;
  options.layers = 7;
  ExpectAgreement({.profiles = 2}, options, 14);
  options.scattering.directional.sigma_0_mm = 0.0;  // no layer is narrow
  ExpectAgreement({.profiles = 1}, options, 14);
}

TEST(EmAgreement, SurfaceReflectionHeldAndNoFloor) {
  EmOptions options = Plain(30);
  options.scattering.reflection = {1.1, 0.35};
  options.background_term = false;
  ExpectAgreement({.profiles = 2}, options, 16);
}

TEST(EmAgreement, ProfilesThatOneLightMisses) {
  const EmOptions options = Plain(20);
  EmCases made = MakeEmCases({.profiles = 3}, options, 15);
  made.batches[1].valid[0] = made.batches[0].valid[2] = made.batches[2].valid[2] = 0;
  const MixtureMap map = Fit(made.lights(), options);
  for (int64_t i = 0; i < 3; ++i) ExpectAsReference(map, i, Reference(made.lights(), i, options));
}

// Profile `from` of each batch, alone or repeated.
EmCases Pick(const EmCases& all, const std::vector<int64_t>& from) {
  EmCases picked;
  for (const SrdBatch& b : all.batches) picked.batches.push_back(ProfilesOf(b, from));
  return picked;
}

TEST(EmBlock, AProfilesResultDoesNotDependOnItsCompany) {
  EmOptions options;
  options.tolerance = 1e-3;  // some lanes settle early and make room
  options.max_iterations = 40;
  EmCases all = MakeEmCases({.profiles = 40, .peak_counts = 500}, options, 16);
  for (SrdBatch& light : all.batches)  // some are of thinned cycles
    for (int i = 0; i < 40; i += 3) light.line_width_mm[i] *= 0.5F;
  const MixtureMap together = Fit(all.lights(), options);
  const auto [least, most] = std::minmax_element(together.iterations.begin(), together.iterations.end());
  ASSERT_LT(*least, *most) << "the test wants profiles that settle at different sweeps";
  for (int i : {0, 17, 18, 38}) {
    const MixtureMap alone = Fit(Pick(all, {i}).lights(), options);
    EXPECT_EQ(alone.iterations[0], together.iterations[i]);
    EXPECT_EQ(alone.divergence[0], together.divergence[i]);
    for (int l = 0; l < options.layers; ++l) {
      EXPECT_EQ(alone.weight[l], together.weight[i * options.layers + l]);
      EXPECT_EQ(alone.depth_mm[l], together.depth_mm[i * options.layers + l]);
      EXPECT_EQ(alone.sigma_mm[l], together.sigma_mm[i * options.layers + l]);
    }
  }
}

TEST(Acceleration, NeverEndsBelowPlainEmAfterAsManySweeps) {
  for (double counts : {200.0, 4000.0, 40000.0}) {
    const EmCases made = MakeEmCases({.profiles = 64, .peak_counts = counts}, Plain(1), 17);
    for (int sweeps : {20, 50}) {
      EmOptions options = Plain(sweeps);
      const MixtureMap plain = Fit(made.lights(), options);
      options.accelerated = true;
      const MixtureMap fast = Fit(made.lights(), options);
      for (int64_t i = 0; i < 64; ++i)
        EXPECT_LE(fast.divergence[i], plain.divergence[i] * (1.0 + 1e-5)) << i << " " << sweeps << " " << counts;
    }
  }
}

TEST(Acceleration, ReachesFiftyPlainSweepsInTwentyOnTheWhole) {
  for (double counts : {200.0, 4000.0, 40000.0}) {
    const EmCases made = MakeEmCases({.profiles = 64, .peak_counts = counts}, Plain(1), 18);
    const MixtureMap plain = Fit(made.lights(), Plain(50));
    EmOptions options = Plain(20);
    options.accelerated = true;
    const MixtureMap fast = Fit(made.lights(), options);
    const auto sum = [](const MixtureMap& m) { return std::accumulate(m.divergence.begin(), m.divergence.end(), 0.0); };
    EXPECT_LT(sum(fast), sum(plain)) << counts;
  }
}

LayerSet TwentyLayers() {
  LayerSet start;
  for (int l = 0; l < 20; ++l) {
    start.weight.push_back(0.02);
    start.depth_mm.push_back(0.05 * l);
    start.sigma_mm.push_back(0.2 + 0.15 * l);
  }
  return start;
}

TEST(Start, LayersGivenAreRefinedAndNoSweepKeepsThem) {
  EmOptions options = Plain(20);
  options.refinement_iterations = 0;
  const EmCases made = MakeEmCases({.profiles = 4}, options, 19);
  const LayerSet start = TwentyLayers();
  const MixtureMap kept = Fit(made.lights(), options, {start});
  options.refinement_iterations = 6;
  const MixtureMap refined = Fit(made.lights(), options, {start});
  for (int64_t i = 0; i < 4; ++i) {
    EXPECT_EQ(kept.iterations[i], 0);
    EXPECT_EQ(refined.iterations[i], 6);
    EXPECT_LT(refined.divergence[i], kept.divergence[i]);
    for (int l = 0; l < options.layers; ++l)
      EXPECT_FLOAT_EQ(kept.depth_mm[i * options.layers + l], static_cast<float>(start.depth_mm[l]));
  }
}

// What a fit to other lights says of a light, in plain double precision.
double DivergenceByHand(const MixtureMap& fit, const SrdBatch& light, int64_t profile, const EmOptions& options) {
  const ProfileLight left_out = ProfileLightOf(light, profile, options);
  const UnlayeredLight mean = MeanOfLights(fit, profile);
  ProfileFit prediction;
  prediction.layers = LayersOf(fit, profile);
  prediction.tau = fit.scattering.tau;
  prediction.directional = fit.scattering.directional;
  prediction.surface = {left_out.reflected >= 0.0 ? left_out.reflected : double{mean.surface}};
  prediction.background = {mean.background};
  return MisfitOf(left_out, ModelOf(prediction, FineGrid(left_out), 0)).divergence;
}

TEST(DivergencesFrom, AreThoseOfThePlainModelForEveryFitAndProfile) {
  for (const bool known : {false, true}) {
    EmOptions options;
    options.background_term = true;
    options.scattering.tau = 0.3;
    if (known) options.scattering.reflection = {1.0, 0.3};
    EmCases made = MakeEmCases({.profiles = 40, .peak_counts = 1000}, options, 17);
    made.batches[2].valid[5] = 0;
    const auto lights = made.lights();
    const std::vector<const SrdBatch*> training = {lights[0], lights[1]};
    EmOptions coarse = options;
    coarse.max_iterations = 2;
    const std::vector<MixtureMap> fits = {Fit(training, options), Fit(training, coarse)};
    const auto divergence = DivergencesFrom(fits, made.batches[2], 1, options);
    ASSERT_EQ(divergence.size(), fits.size());
    for (size_t f = 0; f < fits.size(); ++f)
      for (int64_t i = 0; i < 40; ++i) {
        if (i == 5) {
          EXPECT_TRUE(std::isnan(divergence[f][i]));
          continue;
        }
        const double plain = DivergenceByHand(fits[f], made.batches[2], i, options);
        EXPECT_NEAR(divergence[f][i] / plain, 1.0, 1e-3) << f << ", " << i << (known ? ", reflection known" : "");
      }
  }
}

}  // namespace
}  // namespace stratalux::fit
