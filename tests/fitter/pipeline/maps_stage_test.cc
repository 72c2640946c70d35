// SPDX-License-Identifier: Apache-2.0
// The maps stage on its own: SRDs of four lights in, files out; and which light enters what.
#include <algorithm>
#include <cmath>
#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "fitter/export/exr_file.h"
#include "fitter/stages/layer_maps.h"
#include "fitter/stages/maps.h"
#include "tests/fitter/mixture/known_lights.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr int kHeldOut = 2;

class MapsStage : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }

  static FitOptions Options() {
    FitOptions options;
    options.choose.prior = false;
    options.em.prior.photons = 300.0;
    return options;
  }
  // 12 x 4 pixels of one skin under four lights.
  static SrdSet Srds(double peak_counts, uint64_t seed) {
    Random random(seed);
    SrdSet srds{.pool = 1, .width = 12, .height = 4, .channels = 1, .batches = {}, .row_batches = {}};
    for (double slope : {-1.0, 0.0, 0.58, 1.0})
      srds.batches.push_back(test::CombOf(test::FiveLayers(), slope, 48, peak_counts, Options().em, random));
    return srds;
  }
  FittedLayers FitOf(const SrdSet& srds) {
    FittedLayers layers;
    auto map = FitLayers(srds, kHeldOut, Options(), logger_, "fit");
    EXPECT_TRUE(map.ok()) << map.status().message();
    layers.map = *std::move(map);
    layers.signal_to_noise = SignalToNoise(layers.map, TrainingLightsOf(srds, kHeldOut)->batches);
    return layers;
  }
  AllLayers MapsOf(const SrdSet& srds) {
    const SharedLight shared = FindSharedLight(Options(), TrainingLightsOf(srds, kNoneHeldOut)->batches, srds.Grid());
    auto made = FitMaps(srds, kHeldOut, Options(), shared, logger_, "maps");
    EXPECT_TRUE(made.ok()) << made.status().message();
    return *std::move(made);
  }

  const fs::path folder_ = fs::temp_directory_path() / ("stratalux_maps_stage_" + std::to_string(getpid()));
  Logger logger_;
};

// The held-out light changes the maps, and nothing of the fit that it judges.
TEST_F(MapsStage, TheHeldOutLightEntersTheMapsOnly) {
  for (const double spacing_mm : {0.0, 1.0}) {
    SrdSet srds = Srds(1000.0, 1);
    srds.spacing_mm = spacing_mm;
    SrdSet other = srds;
    for (float& y : other.batches[kHeldOut].y) y *= 1.2F;
    const FittedLayers fit = FitOf(srds), same = FitOf(other);
    for (const auto field : {&MixtureMap::weight, &MixtureMap::depth_mm, &MixtureMap::sigma_mm, &MixtureMap::surface,
                             &MixtureMap::divergence})
      EXPECT_EQ(fit.map.*field, same.map.*field);
    EXPECT_EQ(fit.map.scattering.tau, same.map.scattering.tau);
    const AllLayers maps = MapsOf(srds), changed = MapsOf(other);
    int differing = 0;
    for (int64_t i = 0; i < maps.layers.map.profiles(); ++i)
      differing += maps.layers.map.weight[i * 20] != changed.layers.map.weight[i * 20] ? 1 : 0;
    EXPECT_GT(differing, 40);
  }
}

TEST_F(MapsStage, AreFittedAboutTheNeighboursAndWhatHasNoneAboutTheSessionsMean) {
  constexpr int64_t kHair = 6, kNew = 20;
  SrdSet srds = Srds(400.0, 7);
  srds.spacing_mm = 1.0;
  for (SrdBatch& light : srds.batches) {
    light.apart.assign(48, 0);
    light.apart[kHair] = 1;
  }
  for (int p = 0; p < 4; ++p) srds.batches[p].valid[kNew] = p == kHeldOut ? 1 : 0;
  const AllLayers maps = MapsOf(srds);
  const double near = maps.layers.map.prior_photons;
  ASSERT_GT(near, 300.0);  // pixels of one skin
  ASSERT_TRUE(SaveMaps(folder_, maps).ok());
  const auto layers = LoadMaps(folder_);
  ASSERT_TRUE(layers.ok()) << layers.status().message();
  EXPECT_EQ(layers->map.prior_photons, near);
  EXPECT_EQ(layers->map.session_photons, 300.0);
  const auto photons = [&](int64_t i, double of_prior) {  // of the profile's own
    const double share = layers->map.prior_share[i];
    return of_prior * (1.0 - share) / share;
  };
  const double usual = photons(30, near);
  EXPECT_NEAR(photons(31, near), usual, 0.2 * usual);
  EXPECT_NEAR(photons(kHair, 300.0), usual, 0.2 * usual);
  EXPECT_NEAR(photons(kNew, near), usual / 4.0, 0.1 * usual);  // one light of four, and neighbours
}

TEST_F(MapsStage, WritesWhatTheFitWritesAndWhereItComesFrom) {
  SrdSet srds = Srds(1000.0, 2);
  srds.batches[kHeldOut].valid[5] = 0;
  for (SrdBatch& light : srds.batches) light.valid[9] = 0;
  const FittedLayers fit = FitOf(srds);
  const AllLayers maps = MapsOf(srds);
  ASSERT_TRUE(SaveMaps(folder_, maps).ok());
  ASSERT_TRUE(SaveLayers(folder_, fit).ok());
  ASSERT_TRUE(WriteLayerMaps(folder_, SummariseLayers(fit.map)).ok());
  for (const auto& entry : fs::directory_iterator(folder_))
    EXPECT_TRUE(entry.is_directory() || fs::exists(folder_ / kMapsFolder / entry.path().filename())) << entry.path();

  const auto layers = LoadMaps(folder_);
  ASSERT_TRUE(layers.ok()) << layers.status().message();
  EXPECT_EQ(layers->map.weight, maps.layers.map.weight);
  EXPECT_EQ(layers->map.training_projectors, (std::vector{0, 1, 2, 3}));
  EXPECT_EQ(layers->map.prior_photons, 300.0);
  for (int64_t i = 0; i < layers->map.profiles(); ++i) {
    const float before = fit.signal_to_noise.pixels()[i], now = layers->signal_to_noise.pixels()[i];
    EXPECT_TRUE(i == 5 || i == 9 ? now <= before : now > before) << i << ": more light";
  }
  const auto figures = LoadMapsFigures(folder_);
  ASSERT_TRUE(figures.ok()) << figures.status().message();
  EXPECT_EQ(figures->provenance, "from four projectors");
  EXPECT_THAT(figures->projectors, ElementsAre(0, 1, 2, 3));
  EXPECT_EQ(figures->heldout, kHeldOut);
  EXPECT_EQ(figures->fitted, 47);
  EXPECT_EQ(figures->masked_by_reason, (std::map<std::string, int64_t>{{ToString(FitReason::kNoProjector), 1}}));
  EXPECT_EQ(figures->divergence, maps.figures.divergence);
}

TEST_F(MapsStage, ALaterSchemaIsRefusedAndDamageNamed) {
  ASSERT_TRUE(SaveMaps(folder_, MapsOf(Srds(1000.0, 3))).ok());
  const fs::path file = folder_ / kMapsFolder / "maps.json";
  auto json = nlohmann::json::parse(ReadText(file));
  json["schema"] = 3;
  WriteText(file, json.dump());
  const auto newer = LoadMapsFigures(folder_);
  EXPECT_EQ(newer.status().code(), StatusCode::kNewerSchema);
  EXPECT_THAT(newer.status().message(), HasSubstr(file.string()));
  json["schema"] = 1;
  WriteText(file, json.dump());
  EXPECT_THAT(LoadMapsFigures(folder_).status().message(), HasSubstr("older program"));
  json["schema"] = 2;
  json.erase("profiles");
  WriteText(file, json.dump());
  const auto damaged = LoadMapsFigures(folder_);
  EXPECT_EQ(damaged.status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(damaged.status().message(), HasSubstr(file.string()));
}

TEST_F(MapsStage, CannotBeWrittenWhereAFileStands) {
  const AllLayers maps = MapsOf(Srds(1000.0, 4));
  WriteText(folder_ / kMapsFolder, "");
  const Status failed = SaveMaps(folder_, maps);
  ASSERT_FALSE(failed.ok());
  EXPECT_THAT(failed.message(), HasSubstr((folder_ / kMapsFolder).string()));
}

// A session whose held-out projector lost its sweep: the other three's.
TEST_F(MapsStage, WithoutTheHeldOutSweepTheOthersMakeThem) {
  SrdSet srds = Srds(1000.0, 5);
  std::ranges::fill(srds.batches[kHeldOut].valid, uint8_t{0});
  const AllLayers maps = MapsOf(srds);
  EXPECT_EQ(maps.figures.fitted, 48);
  ASSERT_TRUE(SaveMaps(folder_, maps).ok());
  EXPECT_TRUE(LoadMapsFigures(folder_).ok());
}

TEST(Provenance, SaysHowManyProjectorsAndWhichIsHeldOut) {
  MixtureMap map;
  map.training_projectors = {0, 1, 3};
  EXPECT_EQ(ProvenanceOf(map, 4), "from three projectors, projector 2 held out");
  map.training_projectors = {0, 1, 2, 3, 0, 1, 2, 3};  // with row sweeps
  EXPECT_EQ(ProvenanceOf(map, 4), "from four projectors");
  map.training_projectors = {1};
  EXPECT_EQ(ProvenanceOf(map, 2), "from one projector, projector 0 held out");
}

}  // namespace
}  // namespace stratalux::fit
