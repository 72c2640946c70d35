// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include "fitter/stages/layers.h"
#include "tests/fitter/mixture/known_lights.h"

namespace stratalux::fit {
namespace {

TEST(SharedLight, IsTheSameWhereverTheSurfaceIsPlacedAndForFitsThatAreBlind) {
  FitOptions options;
  options.em.scattering.tau = 0.4;  // of the skin; found anew
  Random random(3);
  std::vector<SrdBatch> lights;
  for (double slope : {-1.0, 0.0, 0.58})
    lights.push_back(test::CombOf(test::FiveLayers(), slope, 400, 4000.0, options.em, random));
  const std::vector<const SrdBatch*> pointers = {&lights[0], &lights[1], &lights[2]};
  const SharedLight before = FindSharedLight(options, pointers, {});
  EXPECT_GT(before.tau, 0.0);
  for (SrdBatch& light : lights)
    for (float& u : light.first_u_mm) u += 0.13F * light.slope_in[0];
  options.em.direction_blind = true;
  const SharedLight after = FindSharedLight(options, pointers, {});
  EXPECT_EQ(after.tau, before.tau);
  EXPECT_EQ(after.reflection.strength, before.reflection.strength);
  EXPECT_EQ(after.reflection.roughness, before.reflection.roughness);
  EXPECT_EQ(after.reflection.over_ggx, before.reflection.over_ggx);
  EXPECT_EQ(after.reflection.hairs, before.reflection.hairs);
  lights[1].y[7] *= 1.5F;  // and it does look at the light
  EXPECT_NE(FindSharedLight(options, pointers, {}).tau, before.tau);
}

TEST(FitLayers, SweepsPooledProfilesAsManyTimesMoreAsTheyAreFewer) {
  FitOptions options;
  options.em.max_iterations = 3;
  options.em.tolerance = 0.0;
  options.choose.prior = false;  // every pixel on its own: its sweeps are counted
  Random random(1);
  SrdSet srds{.pool = 1, .width = 16, .height = 1, .channels = 1, .batches = {}, .row_batches = {}};
  for (double slope : {-1.0, 0.0, 0.58})
    srds.batches.push_back(test::CombOf(test::FiveLayers(), slope, srds.width, 4000.0, options.em, random));
  Logger logger;
  for (int pool : {1, 2}) {
    srds.pool = pool;
    const auto map = FitLayers(srds, 1, options, logger, "fit");
    ASSERT_TRUE(map.ok()) << map.status().message();
    for (const int sweeps : map->iterations) EXPECT_EQ(sweeps, 3 * pool * pool);
  }
}

TEST(FitLayers, SweepsEachPixelAsOftenAsItsLightsAskForAndNoMoreThanAllowed) {
  FitOptions options;
  options.em.tolerance = 0.0;
  options.em.prior.photons = 3000.0;
  options.choose.prior = false;
  Random random(2);
  SrdSet srds{.pool = 1, .width = 64, .height = 1, .channels = 1, .batches = {}, .row_batches = {}};
  for (double slope : {-1.0, 0.0, 0.58})
    srds.batches.push_back(test::CombOf(test::FiveLayers(), slope, srds.width, 4000.0, options.em, random));
  Logger logger;
  const auto sweeps_of = [&](int most) {
    options.em.refinement_iterations = most;
    const auto map = FitLayers(srds, 1, options, logger, "fit");
    EXPECT_TRUE(map.ok()) << map.status().message();
    EXPECT_EQ(std::ranges::min(map->iterations), std::ranges::max(map->iterations));
    return static_cast<int>(map->iterations[0]);
  };
  const int chosen = sweeps_of(60);
  EXPECT_GT(chosen, 1);
  EXPECT_LT(chosen, 30);
  EXPECT_EQ(sweeps_of(1), 1);
}

TEST(FitLayers, AsksNeighboursWhereTheyAreWantedAndKnown) {
  FitOptions options;
  options.em.prior.photons = 300.0;
  options.choose.prior = false;
  Random random(3);
  SrdSet srds{.pool = 1, .width = 12, .height = 8, .channels = 1, .batches = {}, .row_batches = {}, .spacing_mm = 1.0};
  for (double slope : {-1.0, 0.0, 0.58, 1.0})
    srds.batches.push_back(test::CombOf(test::FiveLayers(), slope, 96, 400.0, options.em, random));
  Logger logger;
  const auto asks = [&] {
    const auto map = FitLayers(srds, 1, options, logger, "fit");
    EXPECT_TRUE(map.ok()) << map.status().message();
    EXPECT_TRUE(map->session_photons == 0.0 || map->session_photons == 300.0);
    return map->session_photons > 0.0;
  };
  EXPECT_TRUE(asks());
  const std::string key = FitOptionsJson(options);
  options.choose.neighbours = false;
  EXPECT_FALSE(asks());
  EXPECT_NE(FitOptionsJson(options), key);
  options.choose.neighbours = true;
  srds.spacing_mm = 0.0;  // as of profiles of a file
  EXPECT_FALSE(asks());
  // Without a prior, or of free fits, there is nothing to ask: one key.
  options.em.prior.photons = 0.0;
  const std::string none = FitOptionsJson(options);
  options.choose.neighbours = false;
  EXPECT_EQ(FitOptionsJson(options), none);
}

}  // namespace
}  // namespace stratalux::fit
