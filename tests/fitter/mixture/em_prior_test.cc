// SPDX-License-Identifier: Apache-2.0
// Maximum a posteriori EM: what its sweeps lower, its limits, and the production EM against the reference.
#include <algorithm>
#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/mean_layers.h"
#include "tests/fitter/mixture/em_cases.h"
#include "tests/fitter/mixture/reference_em.h"
#include "tests/fitter/mixture/simd_targets.h"

namespace stratalux::fit {
namespace {

LayerSet MeanSkin(int layers) {
  LayerSet mean;
  for (int l = 0; l < layers; ++l) {
    mean.sigma_mm.push_back(0.15 * std::pow(4.0 / 0.15, (l + 0.5) / layers));
    mean.depth_mm.push_back(0.3 * mean.sigma_mm.back());
    mean.weight.push_back(0.4 / layers);
  }
  mean.background = 0.01;
  return mean;
}

EmOptions Plain(int sweeps, double prior_photons) {
  EmOptions options;
  options.accelerated = false;
  options.background_term = true;
  options.tolerance = 0.0;
  options.refinement_iterations = sweeps;
  options.max_iterations = std::max(sweeps, 1);  // the reference's
  options.prior = {.photons = prior_photons, .square_shift = 0.2};
  return options;
}

MixtureMap Fit(const EmCases& made, const EmOptions& options, const LayerSet& mean) {
  const auto lights = made.lights();
  std::vector<int> projectors(lights.size());
  std::iota(projectors.begin(), projectors.end(), 0);
  auto map = FitMixture(lights, projectors, static_cast<int>(lights[0]->profiles()), 1, 1, options,
                        std::span<const LayerSet>(&mean, 1));
  EXPECT_TRUE(map.ok()) << map.status().message();
  return *std::move(map);
}

std::vector<ProfileLight> LightsOf(const EmCases& made, int64_t profile, const EmOptions& options) {
  std::vector<ProfileLight> lights;
  for (const SrdBatch& b : made.batches)
    if (b.valid[profile] != 0) lights.push_back(ProfileLightOf(b, profile, options));
  return lights;
}

// The profile of `map` as the reference has fits; lights that miss it are left out.
ProfileFit FitOf(const MixtureMap& map, const EmCases& made, int64_t profile, const EmOptions& options) {
  ProfileFit fit;
  fit.layers = LayersOf(map, profile);
  fit.tau = options.scattering.tau;
  fit.directional = options.scattering.directional;
  for (size_t p = 0; p < made.batches.size(); ++p) {
    if (made.batches[p].valid[profile] == 0) continue;
    fit.surface.push_back(map.surface[profile * made.batches.size() + p]);
    fit.background.push_back(map.background[profile * made.batches.size() + p]);
  }
  return fit;
}

double Total(const std::vector<double>& weights) { return std::accumulate(weights.begin(), weights.end(), 0.0); }

TEST(MapEm, NoSweepOfTheReferenceLowersThePosterior) {
  for (double photons : {30.0, 1000.0, 1e6}) {
    EmOptions options = Plain(0, photons);
    const EmCases made = MakeEmCases({.profiles = 4, .peak_counts = 300}, options, 31);
    const MixtureMap start = Fit(made, options, MeanSkin(options.layers));
    for (int64_t i = 0; i < 4; ++i) {
      const auto lights = LightsOf(made, i, options);
      const ProfileFit centre = FitOf(start, made, i, options);
      double last = PenalisedDivergence(lights, centre, centre, options);
      for (int sweeps : {1, 2, 3, 5, 10, 30}) {
        options.max_iterations = sweeps;
        const double now = PenalisedDivergence(lights, centre, RefineReference(lights, centre, options), options);
        EXPECT_LE(now, last * (1.0 + 1e-12)) << photons << " photons, " << sweeps << " sweeps";
        last = now;
      }
    }
  }
}

// At a maximum of the posterior no parameter's small change gains anything: the M step is that of the log prior.
TEST(MapEm, EndsWhereThePosteriorIsStationary) {
  EmOptions options = Plain(0, 500.0);
  options.layers = 3;
  options.background_term = true;  // else samples lie beyond the reach of all three layers
  const EmCases made = MakeEmCases({.profiles = 2, .peak_counts = 300}, options, 32);
  const MixtureMap start = Fit(made, options, MeanSkin(options.layers));
  for (int64_t i = 0; i < 2; ++i) {
    const auto lights = LightsOf(made, i, options);
    const ProfileFit centre = FitOf(start, made, i, options);
    options.max_iterations = 3000;
    const ProfileFit fit = RefineReference(lights, centre, options);
    const auto slope = [&](auto parameter, double scale) {
      constexpr double kStep = 1e-4;
      ProfileFit up = fit, down = fit;
      parameter(up) += kStep * scale;
      parameter(down) -= kStep * scale;
      return (PenalisedDivergence(lights, centre, up, options) - PenalisedDivergence(lights, centre, down, options)) /
             (2.0 * kStep);
    };
    for (size_t l = 0; l < 3; ++l) {
      EXPECT_NEAR(slope([&](ProfileFit& f) -> double& { return f.layers.weight[l]; }, fit.layers.weight[l]), 0, 2e-6);
      EXPECT_NEAR(slope([&](ProfileFit& f) -> double& { return f.layers.depth_mm[l]; }, 1.0), 0.0, 2e-6);
      EXPECT_NEAR(slope([&](ProfileFit& f) -> double& { return f.layers.sigma_mm[l]; }, 1.0), 0.0, 2e-6);
    }
    for (size_t p = 0; p < lights.size(); ++p) {
      EXPECT_NEAR(slope([&](ProfileFit& f) -> double& { return f.surface[p]; }, fit.surface[p]), 0.0, 2e-6);
      EXPECT_NEAR(slope([&](ProfileFit& f) -> double& { return f.background[p]; }, fit.background[p]), 0.0, 2e-6);
    }
  }
}

// Divergence to six decimals, every parameter of a layer that has light to 1e-3.
void ExpectAgreement(const EmCases& made, const EmOptions& options, const LayerSet& mean) {
  EmOptions none = options;
  none.refinement_iterations = 0;
  const MixtureMap start = Fit(made, none, mean), map = Fit(made, options, mean);
  for (int64_t i = 0; i < map.profiles(); ++i) {
    SCOPED_TRACE(i);
    const ProfileFit reference = RefineReference(LightsOf(made, i, options), FitOf(start, made, i, options), options);
    EXPECT_NEAR(map.divergence[i], reference.divergence, 1e-6);
    const ProfileFit fitted = FitOf(map, made, i, options);
    const double total = Total(reference.layers.weight);
    for (size_t l = 0; l < fitted.layers.weight.size(); ++l) {
      EXPECT_NEAR(fitted.layers.weight[l], reference.layers.weight[l], 2e-5 * total) << l;
      if (reference.layers.weight[l] < 1e-3 * total) continue;
      EXPECT_NEAR(fitted.layers.depth_mm[l], reference.layers.depth_mm[l], 1e-3) << l;
      EXPECT_NEAR(fitted.layers.sigma_mm[l] / reference.layers.sigma_mm[l], 1.0, 1e-3) << l;
    }
    for (size_t p = 0; p < fitted.surface.size(); ++p) {
      EXPECT_NEAR(fitted.surface[p], reference.surface[p], 1e-5 * total);
      EXPECT_NEAR(fitted.background[p], reference.background[p], 1e-5 * total);
    }
  }
}

TEST(MapEm, AgreesWithTheReferenceOnEveryInstructionSet) {
  ForEachSimdTarget([](const char* name) {
    SCOPED_TRACE(name);
    for (double photons : {100.0, 3000.0}) {
      const EmOptions options = Plain(20, photons);
      ExpectAgreement(MakeEmCases({.profiles = 2, .peak_counts = 300}, options, 33), options, MeanSkin(options.layers));
    }
  });
}

// As every run has it: no floor.
TEST(MapEm, AgreesWithTheReferenceWhereTheSurfaceIsHeld) {
  EmOptions options = Plain(20, 1000.0);
  options.background_term = false;
  options.scattering.reflection = {1.1, 0.35};
  const EmCases made = MakeEmCases({.profiles = 2, .peak_counts = 300}, options, 37);
  const LayerSet mean = MeanSkin(options.layers);
  ExpectAgreement(made, options, mean);
  const MixtureMap map = Fit(made, options, mean);
  for (size_t p = 0; p < made.batches.size(); ++p)
    EXPECT_NEAR(
        map.surface[p],
        ReflectanceOf(options.scattering.reflection, ReflectionAngles::Of(made.batches[p], 0), options.scattering.eta),
        1e-6);
}

TEST(MapEm, AgreesInOpenWindowsWithDirectionsAndOneFloor) {
  EmOptions options = Plain(20, 2000.0);
  options.scattering.directional = {.kappa_per_mm = 0.4, .phase_slope = 0.5, .sigma_0_mm = 0.4};
  options.shared_background = true;
  options.layers = 7;
  EmCases made = MakeEmCases({.profiles = 3, .samples = 41, .wrapped = false, .peak_counts = 2000}, options, 34);
  made.batches[1].valid[2] = 0;
  ExpectAgreement(made, options, MeanSkin(options.layers));
}

TEST(MapEm, KeepsTheLightOfTheProfileAndWithEndlessPhotonsTheShapeOfTheMean) {
  EmOptions options = Plain(30, 1e6);
  options.background_term = true;
  const EmCases made = MakeEmCases({.profiles = 8, .peak_counts = 300}, options, 35);
  const LayerSet mean = MeanSkin(options.layers);
  const MixtureMap held = Fit(made, options, mean);
  options.prior.photons = 0.0;
  const MixtureMap free = Fit(made, options, mean);
  EXPECT_TRUE(free.prior_share.empty());
  for (int64_t i = 0; i < 8; ++i) {
    const ProfileFit fit = FitOf(held, made, i, options);
    const double total = Total(fit.layers.weight), mean_total = Total(mean.weight);
    for (size_t l = 0; l < fit.layers.weight.size(); ++l) {
      EXPECT_NEAR(fit.layers.weight[l] / total, mean.weight[l] / mean_total, 1e-3);
      EXPECT_NEAR(fit.layers.depth_mm[l], mean.depth_mm[l], 0.02);
      EXPECT_NEAR(fit.layers.sigma_mm[l] / std::max(mean.sigma_mm[l], 0.12), 1.0, 0.02);
    }
    // All light of the model, over the lights, is about that of the data: as without a prior, but for the read noise,
    // with which another shape weighs the samples otherwise.
    const auto shown = [&](const MixtureMap& map) {
      double photons = 0.0;
      const auto lights = LightsOf(made, i, options);
      const ProfileFit of = FitOf(map, made, i, options);
      for (size_t p = 0; p < lights.size(); ++p)
        for (double y : ModelOf(of, FineGrid(lights[p]), p)) photons += lights[p].counts * y;
      return photons;
    };
    EXPECT_NEAR(shown(held) / shown(free), 1.0, 0.01);
    EXPECT_GT(held.prior_share[i], 0.9F);
  }
}

// Mean over the profiles of what the sweeps lower.
double MeanObjective(const EmCases& made, EmOptions options, const LayerSet& mean, int sweeps) {
  options.refinement_iterations = 0;
  const MixtureMap start = Fit(made, options, mean);
  options.refinement_iterations = sweeps;
  const MixtureMap map = Fit(made, options, mean);
  double sum = 0.0;
  for (int64_t i = 0; i < map.profiles(); ++i)
    sum += PenalisedDivergence(LightsOf(made, i, options), FitOf(start, made, i, options), FitOf(map, made, i, options),
                               options);
  return sum / static_cast<double>(map.profiles());
}

TEST(MapEm, ReachesFiftyPlainSweepsInSixteenOnTheWhole) {
  for (double counts : {100.0, 1000.0, 4000.0}) {
    EmOptions options = Plain(1, 1000.0);
    const EmCases made = MakeEmCases({.profiles = 64, .peak_counts = counts, .alike = 64}, options, 37);
    const auto mean = MeanLayers(made.lights(), 1, EmOptions{});
    ASSERT_TRUE(mean.ok());
    const double plain = MeanObjective(made, options, mean->front(), 50);
    options.accelerated = true;
    EXPECT_LT(MeanObjective(made, options, mean->front(), 16), plain * 1.0005) << counts;
  }
}

TEST(MapEm, AcceleratedEndsAtNoLowerPosteriorThanAsManyPlainSweeps) {
  for (double counts : {100.0, 4000.0}) {
    EmOptions options = Plain(8, 1000.0);
    const EmCases made = MakeEmCases({.profiles = 32, .peak_counts = counts}, options, 36);
    const LayerSet mean = MeanSkin(options.layers);
    const MixtureMap plain = Fit(made, options, mean);
    options.accelerated = true;
    const MixtureMap fast = Fit(made, options, mean);
    options.refinement_iterations = 0;
    const MixtureMap start = Fit(made, options, mean);
    for (int64_t i = 0; i < 32; ++i) {
      const auto lights = LightsOf(made, i, options);
      const ProfileFit centre = FitOf(start, made, i, options);
      const auto objective = [&](const MixtureMap& map) {
        return PenalisedDivergence(lights, centre, FitOf(map, made, i, options), options);
      };
      EXPECT_LE(objective(fast), objective(plain) * (1.0 + 1e-5)) << i;
    }
  }
}

}  // namespace
}  // namespace stratalux::fit
