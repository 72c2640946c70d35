// SPDX-License-Identifier: Apache-2.0
// With what a shard goes on that is run again.
#include "fitter/batch/shard.h"

#include <gmock/gmock.h>

#include "db/base/own_hash.h"
#include "fitter/batch/slurm.h"
#include "fitter/mixture/em_kernel.h"
#include "tests/db/store_fixture.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using ::testing::IsEmpty;

class ShardTest : public db::StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    session_ = StoreSession(1);
    work_ = folder_.string() + ".work";
    options_.night.choice.run.store = folder_;
    options_.night.program = "/nonexistent";
    options_.night.memory_bytes = int64_t{1} << 30;
    options_.results = work_ / "results";
    options_.scratch = work_ / "scratch";
    fs::create_directories(options_.scratch);
    plan_.made = WallNow();
    plan_.isa = KernelIsa();
    plan_.visits.push_back({session_, "f1", 1000, {}});
    ASSERT_TRUE(WritePlan(options_.results, plan_).ok());
    auto plan = ReadPlan(options_.results);
    ASSERT_TRUE(plan.ok()) << plan.status().message();
    plan_ = *plan;
  }
  void TearDown() override {
    fs::remove_all(work_);
    StoreTest::TearDown();
  }
  Result<ShardOutcome> Run() {
    Logger quiet(LogLevel::kError);
    return RunShard(
        options_, plan_, -1, [this](const NightEvent& event) { heard_.push_back(event); }, quiet);
  }

  fs::path work_;
  std::string session_;
  ShardOptions options_;
  ShardPlan plan_;
  std::vector<NightEvent> heard_;
};

// What it says of others is not lost to a program that does not understand it.
TEST_F(ShardTest, AManifestOfALaterVersionStaysAsItIs) {
  const fs::path manifest = ManifestFile(options_.results, options_.shard);
  const std::string text = db::WithOwnHash("{\n \"schema\": 2\n}");
  WriteText(manifest, text);
  EXPECT_EQ(Run().status().code(), StatusCode::kNewerSchema);
  EXPECT_EQ(ReadText(manifest), text);
  // Half a one is none.
  WriteText(manifest, text.substr(0, text.size() / 2));
  EXPECT_TRUE(Run().ok());
}

// Nor is one replaced that cannot be opened for the moment: a link to itself is no missing file.
TEST_F(ShardTest, AManifestThatCannotBeOpenedStaysAsItIs) {
  const fs::path manifest = ManifestFile(options_.results, options_.shard);
  fs::create_symlink(manifest.filename(), manifest);
  EXPECT_EQ(Run().status().code(), StatusCode::kFailed);
  EXPECT_TRUE(fs::is_symlink(manifest));
}

// Its manifest was lost; the store has the fit.
TEST_F(ShardTest, WhoIsMergedIsNotFittedAgain) {
  ASSERT_TRUE(MarkMerged(options_.results, session_).ok());
  const auto outcome = Run();
  ASSERT_TRUE(outcome.ok()) << outcome.status().message();
  EXPECT_EQ(outcome->fitted, 1);
  EXPECT_EQ(outcome->failed, 0);
  EXPECT_THAT(heard_, IsEmpty());
  fs::remove(outcome->manifest);
  EXPECT_THAT(ShardsToDo(plan_, options_.results, 1), IsEmpty());
}

}  // namespace
}  // namespace stratalux::fit
