// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "db/catalogue/session_store.h"
#include "fitter/evaluation/truth.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

using ::testing::ElementsAre;

constexpr float kSkin = 1.0F, kEye = 3.0F, kHair = 4.0F;
constexpr float kCheek = 3.0F, kEyeball = 9.0F, kStubble = 12.0F;

class SceneTruthTest : public ::testing::Test {
 protected:
  // One row of quads.
  SceneTruth With(const std::map<std::string, std::vector<float>>& maps) {
    const std::string folder = (folder_ / "store").string();
    EXPECT_TRUE(db::SessionStore::Create(folder).ok());
    auto store = db::SessionStore::Open(folder, db::AccessMode::kReadWrite);
    SessionInfo info;
    info.simulated = true;
    auto writer = store->BeginSession(info);
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (const auto& [name, values] : maps) {
      Image<float> map(static_cast<int>(values.size()), 1);
      std::copy(values.begin(), values.end(), map.data());
      EXPECT_TRUE(writer->AppendTruth(name, std::as_const(map).view()).ok());
    }
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    auto truth = SceneTruth::Open(store->SessionFolder(writer->info().id));
    EXPECT_TRUE(truth.ok() && truth->has_value());
    return **truth;
  }

  const ScratchFolder folder_;
};

std::vector<int> Of(const Result<Image<uint8_t>>& mask) {
  EXPECT_TRUE(mask.ok()) << mask.status().message();
  return {mask->pixels().begin(), mask->pixels().end()};
}

TEST_F(SceneTruthTest, SkinIsWhatAllSitesOfAQuadSee) {
  const SceneTruth truth = With({{"material", {kSkin, kSkin, kEye, kHair}},
                                 {"mixed", {0.0F, 1.0F, 1.0F, 0.0F}},
                                 {"class", {kCheek, kCheek, kEyeball, kStubble}}});
  EXPECT_THAT(Of(truth.Skin()), ElementsAre(1, 0, 0, 0));
  EXPECT_THAT(Of(truth.SkinOrStubble()), ElementsAre(1, 1, 0, 1));  // by their centres
}

TEST_F(SceneTruthTest, OfAnOlderSimulationSkinIsWhatCentresSee) {
  EXPECT_THAT(Of(With({{"material", {kSkin, kSkin, kEye}}}).Skin()), ElementsAre(1, 1, 0));
}

TEST_F(SceneTruthTest, OfAStillOlderOneSkinIsNotSaid) { EXPECT_TRUE(With({{"depth", {700.0F}}}).Skin()->empty()); }

TEST_F(SceneTruthTest, IsAbsentWhereTheSessionHasNone) {
  const auto truth = SceneTruth::Open(folder_.path());
  ASSERT_TRUE(truth.ok());
  EXPECT_FALSE(truth->has_value());
}

}  // namespace
}  // namespace stratalux::fit
