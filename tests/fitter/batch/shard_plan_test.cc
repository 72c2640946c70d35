// SPDX-License-Identifier: Apache-2.0
// What shards share: a plan that each divides alike, and manifests of which half is none.
#include "fitter/batch/shard_plan.h"

#include <gmock/gmock.h>

#include "fitter/batch/shard_manifest.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

class ShardPlanTest : public ScratchFolderTest {
 protected:
  static ShardPlan Plan(int visits) {
    ShardPlan plan;
    plan.made = {1'700'000'000'000'000'000};
    plan.isa = "AVX2";
    plan.program = "1.2.3";
    plan.arguments = {"--layers=3", "--full-evaluation"};
    for (int i = 0; i < visits; ++i)
      plan.visits.push_back({"s" + std::to_string(i), "fit" + std::to_string(i), 1000 + i, {}});
    plan.left_out = {EventOf({"s900", LeftOut::kConsent, "withdrawn"})};
    return plan;
  }
  ShardPlan Written(const ShardPlan& plan) const {
    EXPECT_EQ(WritePlan(folder_, plan).status().message(), "");
    const auto read = ReadPlan(folder_);
    EXPECT_TRUE(read.ok()) << read.status().message();
    return *read;
  }
};

TEST_F(ShardPlanTest, ComesBackAsItWasWritten) {
  ShardPlan plan = Plan(3);
  plan.visits[1].cost = VisitCost{61.5, 1 << 30};
  const ShardPlan read = Written(plan);
  EXPECT_EQ(read.id.size(), 32U);
  EXPECT_EQ(read.made, plan.made);
  EXPECT_EQ(read.isa, "AVX2");
  EXPECT_EQ(read.arguments, plan.arguments);
  ASSERT_EQ(read.visits.size(), 3U);
  EXPECT_EQ(read.visits[2].session, "s2");
  EXPECT_EQ(read.visits[2].fit, "fit2");
  EXPECT_EQ(read.visits[2].sites, 1002);
  EXPECT_FALSE(read.visits[0].cost.has_value());
  ASSERT_TRUE(read.visits[1].cost.has_value());
  EXPECT_EQ(read.visits[1].cost->cpu_seconds, 61.5);
  EXPECT_EQ(read.visits[1].cost->peak_bytes, 1 << 30);
  ASSERT_EQ(read.left_out.size(), 1U);
  EXPECT_EQ(read.left_out[0].why, "consent");
}

TEST_F(ShardPlanTest, IsMadeOnceAndAnyChangedByteIsFound) {
  const ShardPlan plan = Plan(2);
  Written(plan);
  EXPECT_EQ(WritePlan(folder_, plan).status().code(), StatusCode::kUsage);
  const std::string text = ReadText(folder_ / "plan.json");
  std::string changed = text;
  changed[changed.find("fit1") + 3] = '0';
  for (const std::string& other : {changed, text.substr(0, text.size() / 2), std::string()}) {
    WriteText(folder_ / "plan.json", other);
    EXPECT_EQ(ReadPlan(folder_).status().code(), StatusCode::kIntegrity);
  }
  fs::remove(folder_ / "plan.json");
  EXPECT_THAT(ReadPlan(folder_).status().message(), HasSubstr("batch plan --out"));
}

TEST_F(ShardPlanTest, IdsThatAreNoNamesOfFoldersAreRefused) {
  for (const char* id : {"", ".", "..", "../s1", "a/b", ".hidden"}) {
    ShardPlan plan = Plan(1);
    plan.visits[0].session = id;
    fs::remove(folder_ / "plan.json");
    EXPECT_TRUE(WritePlan(folder_, plan).ok());
    EXPECT_EQ(ReadPlan(folder_).status().code(), StatusCode::kIntegrity) << "'" << id << "'";
    // The merge writes a file of that name, too.
    plan = Plan(1);
    plan.left_out[0].session = id;
    fs::remove(folder_ / "plan.json");
    EXPECT_TRUE(WritePlan(folder_, plan).ok());
    EXPECT_EQ(ReadPlan(folder_).status().code(), StatusCode::kIntegrity) << "left out: '" << id << "'";
  }
}

// Told by the merge as it stands there: an end of the night, of a visitor who was left out.
TEST_F(ShardPlanTest, OnlyWhoIsLeftOutStandsAmongThose) {
  ShardPlan plan = Plan(1);
  for (const NightEventKind kind : {NightEventKind::kEnded, NightEventKind::kDone, NightEventKind::kBegan}) {
    plan.left_out[0].kind = kind;
    fs::remove(folder_ / "plan.json");
    EXPECT_TRUE(WritePlan(folder_, plan).ok());
    EXPECT_EQ(ReadPlan(folder_).status().code(), StatusCode::kIntegrity) << ToString(kind);
  }
}

TEST(ShardOfVisits, EveryVisitIsInExactlyOneShardAndTheyHaveAlikeToDo) {
  ShardPlan plan;
  for (int i = 0; i < 1000; ++i)
    plan.visits.push_back({"s", "f", 1, VisitCost{static_cast<double>(1 + i * 37 % 90), 0}});
  std::vector<int> seen(plan.visits.size(), 0);
  double least = 1e9, most = 0.0;
  for (int i = 1; i <= 7; ++i) {
    double seconds = 0.0;
    const std::vector<size_t> own = VisitsOf(plan, {i, 7});
    EXPECT_TRUE(std::is_sorted(own.begin(), own.end())) << "not in the plan's order";
    for (const size_t place : own) {
      ++seen.at(place);
      seconds += plan.visits[place].cost->cpu_seconds;
    }
    least = std::min(least, seconds);
    most = std::max(most, seconds);
  }
  EXPECT_EQ(std::count(seen.begin(), seen.end(), 1), 1000);
  EXPECT_LE(most - least, 90.0) << "more than the longest visit";
}

TEST(ShardOfVisits, WithoutMeasuredTimesTheyTakeTurns) {
  ShardPlan plan;
  plan.visits.resize(5);
  EXPECT_EQ(VisitsOf(plan, {1, 2}), (std::vector<size_t>{0, 2, 4}));
  EXPECT_EQ(VisitsOf(plan, {2, 2}), (std::vector<size_t>{1, 3}));
  EXPECT_TRUE(VisitsOf(plan, {7, 8}).empty());
}

TEST(ShardOfVisits, OnlyAShareIsAShard) {
  for (const char* text : {"", "1", "0/3", "4/3", "1/0", "-1/3", "1/3 ", "1/3x", "a/b", "1/1000001"})
    EXPECT_EQ(ParseShard(text).status().code(), StatusCode::kUsage) << text;
  const auto shard = ParseShard("3/20");
  ASSERT_TRUE(shard.ok());
  EXPECT_EQ(shard->index, 3);
  EXPECT_EQ(shard->count, 20);
}

class ShardManifestTest : public ShardPlanTest {
 protected:
  static ShardManifest Manifest(const ShardPlan& plan) {
    ShardManifest manifest{plan.id, {2, 3}, {}};
    manifest.Say({{.kind = NightEventKind::kFailed, .session = "s0", .reason = "first"}, {}});
    manifest.Say({{.kind = NightEventKind::kDone, .session = "s1", .fit = "fit1", .cpu_seconds = 3.5},
                  {{"artifacts/srd-0123", "00"}, {"fits/fit1", "11"}}});
    manifest.Say({{.kind = NightEventKind::kSetAside, .session = "s0", .reason = "error: \"no\"\n\xff"}, {}});
    return manifest;
  }
};

TEST_F(ShardManifestTest, ComesBackWithTheLastWordOfEach) {
  const ShardPlan plan = Written(Plan(2));
  ASSERT_TRUE(WriteManifest(folder_, Manifest(plan)).ok());
  const auto files = *ManifestFiles(folder_);
  ASSERT_EQ(files.size(), 1U);
  EXPECT_EQ(files[0].filename(), "shard-0002-of-0003.json");
  const auto read = ReadManifest(files[0], plan);
  ASSERT_TRUE(read.ok()) << read.status().message();
  ASSERT_EQ(read->visits.size(), 2U);
  EXPECT_EQ(read->Find("s0")->end.kind, NightEventKind::kSetAside);
  EXPECT_THAT(read->Find("s0")->end.reason, HasSubstr("error: \"no\"\n"));
  EXPECT_EQ(read->Find("s1")->end.cpu_seconds, 3.5);
  EXPECT_EQ(read->Find("s1")->made.at(1).place, "fits/fit1");
  EXPECT_EQ(read->Find("s2"), nullptr);
}

TEST_F(ShardManifestTest, AnyPartOfOneIsNone) {
  const ShardPlan plan = Written(Plan(2));
  ASSERT_TRUE(WriteManifest(folder_, Manifest(plan)).ok());
  const fs::path file = ManifestFiles(folder_)->at(0);
  const std::string text = ReadText(file);
  for (size_t bytes = 0; bytes < text.size(); bytes += 7) {
    WriteText(file, text.substr(0, bytes));
    EXPECT_EQ(ReadManifest(file, plan).status().code(), StatusCode::kIntegrity) << bytes << " bytes of it";
  }
}

// The merge tells it to the night as it stands there.
TEST_F(ShardManifestTest, OnlyAnEndOfAVisitorIsOne) {
  const ShardPlan plan = Written(Plan(2));
  for (const NightEventKind kind : {NightEventKind::kEnded, NightEventKind::kBegan, NightEventKind::kRetry}) {
    ShardManifest manifest = Manifest(plan);
    manifest.visits[0].end.kind = kind;
    ASSERT_TRUE(WriteManifest(folder_, manifest).ok());
    EXPECT_EQ(ReadManifest(ManifestFiles(folder_)->at(0), plan).status().code(), StatusCode::kIntegrity)
        << ToString(kind);
  }
}

TEST_F(ShardManifestTest, OneOfAnotherPlanOrThatLeavesItsFolderIsRefused) {
  const ShardPlan plan = Written(Plan(2));
  ShardPlan other = plan;
  other.id = "another";
  ASSERT_TRUE(WriteManifest(folder_, Manifest(other)).ok());
  EXPECT_THAT(ReadManifest(ManifestFiles(folder_)->at(0), plan).status().message(), HasSubstr("another plan"));
  for (const char* place :
       {"fits/..", "fits/../..", "artifacts/a/b", "/etc", "fits/", "sessions/x", "artifacts/.lock"}) {
    ShardManifest manifest = Manifest(plan);
    manifest.visits[0].made = {{place, "00"}};
    ASSERT_TRUE(WriteManifest(folder_, manifest).ok());
    EXPECT_EQ(ReadManifest(ManifestFiles(folder_)->at(0), plan).status().code(), StatusCode::kIntegrity) << place;
  }
}

}  // namespace
}  // namespace stratalux::fit
