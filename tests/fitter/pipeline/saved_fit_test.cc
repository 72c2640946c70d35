// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <string>

#include <gtest/gtest.h>

#include "fitter/export/exr_file.h"
#include "fitter/stages/layers_file.h"
#include "fitter/stages/motion.h"
#include "fitter/stages/reflection_json.h"
#include "shared/base/random.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

// 3 x 2 pixels, 3 colours, one layer.
MixtureMap OneLayerMap() {
  MixtureMap map;
  map.width = 3;
  map.height = 2;
  map.channels = 3;
  map.layers = 1;
  map.training_projectors = {0};
  const auto profiles = static_cast<size_t>(map.profiles());
  for (auto* v : {&map.weight, &map.depth_mm, &map.sigma_mm, &map.surface, &map.background}) v->assign(profiles, 0.5F);
  map.iterations.assign(profiles, 4);
  map.reason.assign(profiles, static_cast<uint8_t>(FitReason::kFitted));
  for (size_t i = 0; i < profiles; ++i) map.divergence.push_back(0.01F * static_cast<float>(i));
  return map;
}

TEST(SavedFit, QualitySaysThePriorsShareAndKeepsWhatOlderReadersNeed) {
  const ScratchFolder folder;
  MixtureMap map = OneLayerMap();
  const Image<float> noise(3, 2, 3, 40.0F);
  ASSERT_TRUE(SaveLayers(folder.path(), {map, 1, noise}).ok());
  const std::vector<std::string> shares = {"prior_share.R", "prior_share.G", "prior_share.B"};
  const auto none = ReadExr(folder / "quality.exr", shares);
  ASSERT_TRUE(none.ok()) << none.status().message();
  for (float share : none->pixels()) EXPECT_EQ(share, 0.0F);

  for (int64_t i = 0; i < map.profiles(); ++i) map.prior_share.push_back(0.05F * static_cast<float>(i));
  ASSERT_TRUE(SaveLayers(folder.path(), {map, 1, noise}).ok());
  const auto quality = ReadExr(folder / "quality.exr", shares);
  const auto older = ReadExr(folder / "quality.exr", {"divergence.R", "signal_to_noise.G"});
  ASSERT_TRUE(quality.ok() && older.ok());
  for (int y = 0; y < 2; ++y)
    for (int x = 0; x < 3; ++x) {
      for (int c = 0; c < 3; ++c) EXPECT_EQ((*quality)(x, y, c), map.prior_share[map.ProfileIndex(x, y, c)]);
      EXPECT_EQ((*older)(x, y, 0), map.divergence[map.ProfileIndex(x, y, 0)]);
      EXPECT_EQ((*older)(x, y, 1), 40.0F);
    }
}

TEST(SavedFit, OfAHeadThatMovedKnowsHowAndOneOfBeforeNothing) {
  const ScratchFolder folder;
  const auto before = LoadMotion(folder.path());
  ASSERT_TRUE(before.ok()) << before.status().message();
  EXPECT_FALSE(before->moved());
  EXPECT_TRUE(before->head.poses.empty());
  FaceMotion motion;
  motion.reference.ns = 123456789012;
  motion.projectors = {{0.5, 0.75, 1.5}, {3.0, 3.25, 4.0}};
  motion.head.pivot = {1.0, 2.0, 700.0};
  motion.head.moved = true;
  motion.head.largest_mm = 0.5;
  motion.head.poses = {{0.0, {}}, {2.0, {{0.001, 0.002, -0.003}, {0.25, -0.5, 0.125}}}};
  ASSERT_TRUE(SaveMotion(folder.path(), motion).ok());
  const auto back = LoadMotion(folder.path());
  ASSERT_TRUE(back.ok()) << back.status().message();
  EXPECT_EQ(back->reference, motion.reference);
  EXPECT_EQ(back->projectors[1].sweep_s, 4.0);
  const Eigen::Vector3d point(30.0, -20.0, 680.0);
  EXPECT_EQ(back->head.At(1.3) * point, motion.head.At(1.3) * point);
  WriteText(folder.path() / "motion.json", R"({"moved": "perhaps"})");
  EXPECT_EQ(LoadMotion(folder.path()).status().code(), StatusCode::kIntegrity);
}

// A run goes on with the layers that it has made, another one with those that it reads: both must come to the same.
TEST(SavedFit, WhatIsReadIsWhatWasMade) {
  const ScratchFolder folder;
  Random random(5);
  MixtureMap map;
  map.width = 5;
  map.height = 3;
  map.channels = 3;
  map.layers = 4;
  map.training_projectors = {0, 2, 0};  // the last one's rows
  map.scattering = {.shift_law = ShiftLaw::kRefractedSine,
                    .eta = 1.4 / 3.0 + 1.0,
                    .gain_model = false,
                    .tau = random.Uniform(),
                    .directional = {random.Uniform(), random.Uniform(), random.Uniform()},
                    .reflection = {random.Uniform(0.5, 2.0), random.Uniform(0.1, 0.5)}};
  for (double& times : map.scattering.reflection.over_ggx) times = random.Uniform(0.0, 3.0);
  map.scattering.reflection.hairs = random.Uniform(0.0, 0.01);
  for (double& more : map.scattering.reflection.by_gloss) more = random.Uniform(-1.0, 1.0);
  map.scattering.reflection.gloss = {5, 3, 2, 4, {}};
  for (int k = 0; k < 12; ++k) map.scattering.reflection.gloss.nodes.push_back(random.Uniform());
  map.prior_photons = 1000.0 / 7.0;
  map.session_photons = 100.0 / 7.0;
  const auto profiles = static_cast<size_t>(map.profiles());
  const auto fill = [&](std::vector<float>& values, size_t count) {
    for (size_t i = 0; i < count; ++i) values.push_back(static_cast<float>(random.Uniform(-1.0, 1.0) / 3.0));
  };
  for (auto* values : {&map.weight, &map.depth_mm, &map.sigma_mm}) fill(*values, 4 * profiles);
  for (auto* values : {&map.surface, &map.background}) fill(*values, 3 * profiles);
  for (auto* values : {&map.divergence, &map.prior_share}) fill(*values, profiles);
  for (size_t i = 0; i < profiles; ++i) {
    map.iterations.push_back(static_cast<uint16_t>(65535 - 7 * i));
    map.reason.push_back(static_cast<uint8_t>(i % kFitReasons));
  }
  Image<float> noise(5, 3, 3);
  for (float& v : noise.pixels()) v = static_cast<float>(100.0 * random.Uniform());
  ASSERT_TRUE(SaveLayers(folder.path(), {map, 2, noise}).ok());
  const auto read = LoadLayers(folder.path());
  ASSERT_TRUE(read.ok()) << read.status().message();
  const MixtureMap& back = read->map;
  EXPECT_EQ(read->pool, 2);
  EXPECT_TRUE(std::ranges::equal(read->signal_to_noise.pixels(), noise.pixels()));
  for (const auto size : {&MixtureMap::width, &MixtureMap::height, &MixtureMap::channels, &MixtureMap::layers})
    EXPECT_EQ(back.*size, map.*size);
  for (const auto values : {&MixtureMap::weight, &MixtureMap::depth_mm, &MixtureMap::sigma_mm, &MixtureMap::surface,
                            &MixtureMap::background, &MixtureMap::divergence, &MixtureMap::prior_share})
    EXPECT_EQ(back.*values, map.*values);
  EXPECT_EQ(back.iterations, map.iterations);
  EXPECT_EQ(back.reason, map.reason);
  EXPECT_EQ(back.training_projectors, map.training_projectors);
  EXPECT_EQ(back.prior_photons, map.prior_photons);
  EXPECT_EQ(back.session_photons, map.session_photons);
  const ScatteringModel &is = back.scattering, &was = map.scattering;
  EXPECT_EQ(is.mode, was.mode);
  EXPECT_EQ(is.shift_law, was.shift_law);
  EXPECT_EQ(is.eta, was.eta);
  EXPECT_EQ(is.gain_model, was.gain_model);
  EXPECT_EQ(is.tau, was.tau);
  EXPECT_EQ(is.directional.kappa_per_mm, was.directional.kappa_per_mm);
  EXPECT_EQ(is.directional.phase_slope, was.directional.phase_slope);
  EXPECT_EQ(is.directional.sigma_0_mm, was.directional.sigma_0_mm);
  EXPECT_EQ(is.reflection.strength, was.reflection.strength);
  EXPECT_EQ(is.reflection.roughness, was.reflection.roughness);
  EXPECT_EQ(is.reflection.over_ggx, was.reflection.over_ggx);
  EXPECT_EQ(is.reflection.hairs, was.reflection.hairs);
  EXPECT_EQ(is.reflection.by_gloss, was.reflection.by_gloss);
  for (int64_t profile = 0; profile < map.profiles(); ++profile)
    EXPECT_EQ(is.reflection.gloss.At(profile), was.reflection.gloss.At(profile));
}

// A damaged field must not be looked up.
TEST(SavedFit, OfAGlossOfAnotherMapIsRefused) {
  const ScratchFolder folder;
  MixtureMap map = OneLayerMap();
  map.scattering.reflection = {1.0, 0.3};
  map.scattering.reflection.gloss = {3, 3, 2, 3, {0.0, 0.1, 0.2, 0.3, 0.4, 0.5}};
  ASSERT_TRUE(SaveLayers(folder.path(), {map, 1, Image<float>(3, 2, 3, 40.0F)}).ok());
  const auto sound = LoadLayers(folder.path());
  EXPECT_TRUE(sound.ok()) << sound.status().message();
  const std::string whole = ReadText(folder / "layers.json");
  for (const auto& [member, other] : {std::pair("columns", "0"),
                                      {"columns", "6"},
                                      {"cell_px", "0"},
                                      {"cell_px", "1"},
                                      {"width", "0"},
                                      {"channels", "1"},
                                      {"nodes", "[0.1]"},
                                      {"nodes", "[0.0, 0.1, 0.2, 0.3, 0.4, -0.5]"},
                                      {"columns", "-3"}}) {
    nlohmann::json json = nlohmann::json::parse(whole);
    json["surface"]["gloss"][member] = nlohmann::json::parse(other);
    WriteText(folder / "layers.json", json.dump());
    const auto read = LoadLayers(folder.path());
    EXPECT_EQ(read.status().code(), StatusCode::kIntegrity) << member << " " << other;
  }
}

// What an older program would read as another surface it must not read at all.
TEST(SavedFit, OfANewerSchemaIsRefused) {
  const ScratchFolder folder;
  ASSERT_TRUE(SaveLayers(folder.path(), {OneLayerMap(), 1, Image<float>(3, 2, 3, 40.0F)}).ok());
  EXPECT_TRUE(LoadLayers(folder.path()).ok());
  std::string text = ReadText(folder / "layers.json");
  const std::string schema = "\"schema\": 3";
  ASSERT_NE(text.find(schema), std::string::npos);
  text.replace(text.find(schema), schema.size(), "\"schema\": 4");
  WriteText(folder / "layers.json", text);
  EXPECT_EQ(LoadLayers(folder.path()).status().code(), StatusCode::kNewerSchema);
}

TEST(ReflectionJson, OfAProgramThatKnewNeitherCurveNorHairsNorGlossIsGgxAlone) {
  const SurfaceReflection read = ReflectionFrom(nlohmann::json::parse(R"({"strength": 1.25, "roughness": 0.3})"));
  EXPECT_EQ(read.strength, 1.25);
  EXPECT_EQ(read.roughness, 0.3);
  EXPECT_EQ(read.over_ggx, SurfaceReflection{}.over_ggx);
  EXPECT_EQ(read.hairs, 0.0);
  EXPECT_EQ(read.gloss.At(7), 0.0);
  EXPECT_FALSE(ReflectionFrom(nlohmann::json(ReflectionJson({}))).Known());
}

}  // namespace
}  // namespace stratalux::fit
