// SPDX-License-Identifier: Apache-2.0
// What a merge does with the results, whatever a shard made.
#include "fitter/batch/merge.h"

#include <fstream>

#include <gmock/gmock.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/ledger/ledger_line.h"
#include "fitter/batch/night_status.h"
#include "tests/db/store_fixture.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class MergeTest : public db::StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    (void)OpenStore();
    work_ = folder_.string() + ".work";
    results_ = work_ / "results";
    fs::create_directories(work_);
  }
  void TearDown() override {
    fs::remove_all(work_);
    StoreTest::TearDown();
  }
  // With something of a visitor in it.
  void Planned(const std::vector<std::string>& fitted) const {
    ShardPlan plan;
    plan.made = WallNow();
    for (const std::string& session : fitted) plan.visits.push_back({session, "f1", 1000, {}});
    ASSERT_EQ(WritePlan(results_, plan).status().message(), "");
    Face(results_);
  }
  static void Face(const fs::path& folder) {
    fs::create_directories(folder / "sessions");
    std::ofstream(folder / "sessions" / "face.exr") << "a face";
  }
  [[nodiscard]] Result<MergeOutcome> Merge(const fs::path& results, MergeMode mode) const {
    Logger quiet(LogLevel::kError);
    return MergeShards(folder_, results, mode, quiet);
  }
  // As a merge that was killed behind the rename has left them.
  [[nodiscard]] fs::path AsideOf(pid_t process) const {
    const fs::path aside = results_.string() + ".closed-" + std::to_string(process);
    Face(aside);
    return aside;
  }
  static pid_t GoneProcess() {
    const pid_t child = fork();
    if (child == 0) _exit(0);
    waitpid(child, nullptr, 0);
    return child;
  }
  std::string Fitted() const {
    const std::string session = StoreSession(1);
    auto store = OpenStore();
    fs::create_directories(store.FitFolder(session, "f1"));
    EXPECT_TRUE(store.RegisterFit({"f1", session, "{}", "{}", WallNow()}).ok());
    return session;
  }

  fs::path work_, results_;
};

TEST_F(MergeTest, ClosingALinkRemovesTheFolderThatItLeadsTo) {
  Planned({});
  const fs::path link = work_ / "night";
  fs::create_directory_symlink(results_, link);
  const auto outcome = Merge(link, MergeMode::kClose);
  ASSERT_TRUE(outcome.ok()) << outcome.status().message();
  EXPECT_TRUE(fs::is_empty(work_)) << *fs::directory_iterator(work_);
}

// Killed between the rename and the removal of the link: that leads to nothing, and no plan can be written there.
TEST_F(MergeTest, ACloseThroughALinkThatWasKilledIsFinishedByTheNextOne) {
  for (const std::string end : {"", "/"})
    for (const fs::path& target : {results_, fs::path("results"), fs::path("results/")}) {
      const fs::path left = AsideOf(GoneProcess()), night = work_ / "night", further = work_ / "further";
      fs::create_directory_symlink(target, further);
      fs::create_directory_symlink("further", night);
      EXPECT_EQ(Merge(night.string() + end, MergeMode::kKeep).status().code(), StatusCode::kNotFound);
      EXPECT_TRUE(fs::exists(left) && fs::is_symlink(night)) << "nobody asked for it";
      EXPECT_EQ(Merge(night.string() + end, MergeMode::kClose).status().code(), StatusCode::kNotFound);
      EXPECT_FALSE(fs::exists(left)) << target << end;
      EXPECT_FALSE(fs::is_symlink(night)) << target << end;
      EXPECT_TRUE(fs::is_symlink(further)) << "another name, which nobody gave";
      fs::remove(further);
    }
}

// A folder without a plan, or one of a file system that is not there for the moment: no close was killed.
TEST_F(MergeTest, ALinkThatNoCloseLeftStays) {
  fs::create_directories(results_);
  for (const fs::path& target : {results_, work_ / "mount" / "results", fs::path("night")}) {
    fs::create_directory_symlink(target, work_ / "night");
    EXPECT_FALSE(Merge(work_ / "night", MergeMode::kClose).ok());
    EXPECT_TRUE(fs::is_symlink(work_ / "night")) << target;
    fs::remove(work_ / "night");
  }
}

TEST_F(MergeTest, WhatAKilledCloseHasLeftGoesWithTheNextOne) {
  const fs::path left = AsideOf(GoneProcess()), of_our_number = AsideOf(getpid()), at_work = AsideOf(getppid());
  fs::create_directories(results_.string() + ".closed-by-hand");
  // Though there is nothing to close any more.
  EXPECT_EQ(Merge(results_, MergeMode::kKeep).status().code(), StatusCode::kNotFound);
  EXPECT_TRUE(fs::exists(left)) << "nobody asked for it";
  EXPECT_EQ(Merge(results_, MergeMode::kClose).status().code(), StatusCode::kNotFound);
  EXPECT_FALSE(fs::exists(left));
  EXPECT_FALSE(fs::exists(of_our_number));
  EXPECT_TRUE(fs::exists(at_work / "sessions" / "face.exr"));
  EXPECT_TRUE(fs::exists(results_.string() + ".closed-by-hand"));
  const fs::path again = AsideOf(GoneProcess());
  Planned({});
  ASSERT_TRUE(Merge(results_, MergeMode::kClose).ok());
  EXPECT_FALSE(fs::exists(again));
  EXPECT_FALSE(fs::exists(results_));
}

// A folder of the results that cannot be written or removed.
TEST_F(MergeTest, AFaultBelowOneVisitorKeepsNobodyElse) {
  const std::string first = Fitted(), second = Fitted();
  Planned({first, second});
  std::ofstream(results_ / "sessions" / first) << "no folder";
  const auto outcome = Merge(results_, MergeMode::kKeep);
  ASSERT_TRUE(outcome.ok()) << outcome.status().message();
  EXPECT_EQ(outcome->present, 2);
  ASSERT_THAT(outcome->problems, SizeIs(1));
  EXPECT_THAT(outcome->problems[0], HasSubstr(first));
  EXPECT_TRUE(IsMerged(results_, second));
}

// What cannot be read for the moment, as on a network file system that fails, may be a fit that nobody else has.
TEST_F(MergeTest, WhatCannotBeReadOfTheResultsIsNotRemoved) {
  const std::string first = StoreSession(1), second = Fitted();
  Planned({first, second});
  const auto plan = ReadPlan(results_);
  ASSERT_TRUE(plan.ok());
  ShardManifest manifest{plan->id, {1, 1}, {}};
  manifest.Say({{.kind = NightEventKind::kDone, .session = first, .fit = "f1"},
                {{"fits/f1", "0123456789abcdef0123456789abcdef"}}});
  ASSERT_TRUE(WriteManifest(results_, manifest).ok());
  const fs::path record = ResultsOf(results_, first) / "fits" / "f1" / "fit.json";
  fs::create_directories(record);
  const auto outcome = Merge(results_, MergeMode::kKeep);
  ASSERT_TRUE(outcome.ok()) << outcome.status().message();
  EXPECT_EQ(outcome->present, 1) << "it keeps nobody else";
  EXPECT_THAT(outcome->unread, SizeIs(1));
  EXPECT_THAT(outcome->missing, ElementsAre(first));
  const Status closed = Merge(results_, MergeMode::kClose).status();
  EXPECT_EQ(closed.code(), StatusCode::kFailed);
  EXPECT_THAT(closed.message(), HasSubstr(record.string()));
  EXPECT_TRUE(fs::exists(record));
  EXPECT_FALSE(StatusOf(ReadNight(folder_ / "nights" / outcome->night)->events).ended) << "it is not over";
  // Another file than the manifest speaks of is damage: nothing that could be merged.
  fs::remove(record);
  WriteText(record, "another");
  ASSERT_TRUE(Merge(results_, MergeMode::kClose).ok());
  EXPECT_FALSE(fs::exists(results_));
}

TEST_F(MergeTest, AManifestThatCannotBeReadKeepsTheResults) {
  const std::string session = StoreSession(1);
  Planned({session});
  const fs::path manifest = ManifestFile(results_, {1, 1});
  fs::create_symlink(manifest.filename(), manifest);
  EXPECT_THAT(Merge(results_, MergeMode::kKeep)->unread, SizeIs(1));
  EXPECT_EQ(Merge(results_, MergeMode::kClose).status().code(), StatusCode::kFailed);
  EXPECT_TRUE(fs::exists(results_));
  fs::remove(manifest);
  WriteText(manifest, "half a manif");
  EXPECT_TRUE(Merge(results_, MergeMode::kClose).ok());
}

// Whether somebody was forgotten is not known for the moment: what was made of them is kept.
TEST_F(MergeTest, ALedgerThatCannotBeReadDropsNobody) {
  const std::string session = StoreSession(1);
  Planned({session});
  const fs::path made = ResultsOf(results_, session) / "fits" / "f1";
  fs::create_directories(made);
  const fs::path later = folder_ / "ledger" / "0123456789abcdef0123456789abcdef.jsonl";
  const std::string said = R"({"schema":99,"kind":"sealing")";
  fs::create_directories(later.parent_path());
  WriteText(later, said + ",\"hash\":\"" + db::LedgerHash(said + "}") + "\"}\n");
  EXPECT_EQ(Merge(results_, MergeMode::kKeep).status().code(), StatusCode::kNewerSchema);
  EXPECT_TRUE(fs::exists(made));
  fs::remove(later);
  const auto outcome = Merge(results_, MergeMode::kKeep);
  ASSERT_TRUE(outcome.ok()) << outcome.status().message();
  EXPECT_EQ(outcome->dropped, 0);
  EXPECT_THAT(outcome->missing, SizeIs(1));
}

// A shard that was run again behind the merge.
TEST_F(MergeTest, WhatWasMadeAgainOfWhoIsMergedGoes) {
  const std::string session = Fitted();
  Planned({session});
  ASSERT_TRUE(Merge(results_, MergeMode::kKeep).ok());
  fs::create_directories(ResultsOf(results_, session) / "fits" / "f1");
  const auto outcome = Merge(results_, MergeMode::kKeep);
  ASSERT_TRUE(outcome.ok()) << outcome.status().message();
  EXPECT_THAT(outcome->problems, IsEmpty());
  EXPECT_FALSE(fs::exists(ResultsOf(results_, session) / "fits"));
  EXPECT_TRUE(IsMerged(results_, session));
}

}  // namespace
}  // namespace stratalux::fit
