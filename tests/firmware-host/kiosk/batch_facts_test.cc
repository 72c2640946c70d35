// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/batch_facts.h"

#include <chrono>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "db/catalogue/job_store.h"
#include "shared/units/time.h"
#include "tests/db/index_rows.h"
#include "tests/db/store_fixture.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using Here = TimerFacts::Here;

TEST(TimerOf, ReadsWhatSystemctlPrintsOfATimer) {
  const std::string of_252 =
      "NextElapseUSecRealtime=Tue 2026-11-24 20:00:00 UTC\nLastTriggerUSec=Mon 2026-11-23 20:00:01 UTC\n"
      "Id=stratalux-batch.timer\nLoadState=loaded\nActiveState=active\n";
  const TimerFacts timer = TimerOf(of_252, kBatchTimer);
  EXPECT_EQ(timer.here, Here::kOn);
  EXPECT_EQ(timer.next->ns, 1795550400 * kSecondNs);
  EXPECT_EQ(timer.last->ns, 1795464001 * kSecondNs);
  const TimerFacts unix_times = TimerOf(
      "Id=stratalux-batch.timer\nLoadState=loaded\nActiveState=active\nNextElapseUSecRealtime=@1795550400\n"
      "LastTriggerUSec=\n",
      kBatchTimer);
  EXPECT_EQ(unix_times.next->ns, 1795550400 * kSecondNs);
  EXPECT_FALSE(unix_times.last) << "it has not gone off yet";
}

TEST(TimerOf, KnowsNoTimeOfATimerThatIsOffOrAbsent) {
  EXPECT_EQ(TimerOf("Id=stratalux-batch.timer\nLoadState=not-found\nActiveState=inactive\n", kBatchTimer),
            (TimerFacts{Here::kAbsent, {}, {}}));
  EXPECT_EQ(TimerOf("Id=stratalux-batch.timer\nLoadState=loaded\nActiveState=inactive\n"
                    "NextElapseUSecRealtime=Tue 2026-11-24 20:00:00 UTC\n",
                    kBatchTimer),
            (TimerFacts{Here::kOff, {}, {}}));
}

TEST(TimerOf, TellsTheTimersApart) {
  const std::string two =
      "Id=stratalux-pull.timer\nLoadState=loaded\nActiveState=active\n\n"
      "Id=stratalux-batch.timer\nLoadState=not-found\nActiveState=inactive\n";
  EXPECT_EQ(TimerOf(two, kBatchTimer).here, Here::kAbsent);
  EXPECT_EQ(TimerOf(two, "stratalux-pull.timer").here, Here::kOn);
  EXPECT_EQ(TimerOf(two, "another.timer").here, Here::kUnknown);
}

TEST(TimerOf, MakesNothingOfWhatItDoesNotKnow) {
  for (const char* text : {"", "\n\n", "=", "Failed to connect to bus: Host is down\n", "Id=stratalux-batch.timer\n"})
    EXPECT_EQ(TimerOf(text, kBatchTimer), TimerFacts()) << text;
  for (const char* time : {"n/a", "0", "@0", "@99999999999999999999", "Tue 2026-11-24 20:00:00 CET", "soon"}) {
    const TimerFacts timer = TimerOf(
        "Id=stratalux-batch.timer\nLoadState=loaded\nActiveState=active\nNextElapseUSecRealtime=" + std::string(time) +
            "\n",
        kBatchTimer);
    EXPECT_EQ(timer.here, Here::kOn);
    EXPECT_FALSE(timer.next) << time;
  }
}

class AskTimerTest : public ScratchFolderTest {
 protected:
  [[nodiscard]] std::string Program(const std::string& script) const {
    const fs::path file = folder_ / "systemctl";
    std::ofstream(file) << "#!/bin/sh\n" << script;
    fs::permissions(file, fs::perms::owner_all);
    return file.string();
  }
};

TEST_F(AskTimerTest, AsksInUtcForTheTimerAlone) {
  const TimerFacts timer = AskTimer(Program("[ \"$TZ\" = UTC ] && [ \"$1\" = show ] || exit 1\n"
                                            "for unit; do :; done\n"
                                            "printf 'Id=%s\\nLoadState=loaded\\nActiveState=active\\n"
                                            "NextElapseUSecRealtime=Tue 2026-11-24 20:00:00 UTC\\n' \"$unit\"\n"),
                                    kBatchTimer);
  EXPECT_EQ(timer.here, Here::kOn);
  EXPECT_EQ(timer.next->ns, 1795550400 * kSecondNs);
}

TEST_F(AskTimerTest, ThatFailsOrIsNotThereIsUnknown) {
  EXPECT_EQ(AskTimer(Program("echo Id=stratalux-batch.timer; echo LoadState=loaded; exit 1\n"), kBatchTimer),
            TimerFacts());
  EXPECT_EQ(AskTimer("/nonexistent/systemctl", kBatchTimer), TimerFacts());
}

// Three seconds are AskTimer's; the machine may be busy.
TEST_F(AskTimerTest, IsAnsweredThoughSystemctlHangsIgnoresSignalsOrLeavesSomebodyBehind) {
  const std::string on = "echo Id=stratalux-batch.timer; echo LoadState=loaded; echo ActiveState=active\n";
  for (const std::string& hanging :
       {std::string("exec sleep 60\n"), std::string("trap '' TERM\nsleep 60\nsleep 60\n")}) {
    const auto begun = std::chrono::steady_clock::now();
    EXPECT_EQ(AskTimer(Program(on + hanging), kBatchTimer), TimerFacts()) << hanging;
    EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(30)) << hanging;
  }
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_EQ(AskTimer(Program(on + "sleep 60 &\n"), kBatchTimer).here, Here::kOn) << "it ended and said what it knows";
  EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(30));
}

TEST_F(AskTimerTest, SystemctlCannotSpeakToSystemdInTheKiosksName) {
  setenv("NOTIFY_SOCKET", "/run/systemd/notify", 1);
  const TimerFacts timer = AskTimer(Program("[ -z \"$NOTIFY_SOCKET\" ] || exit 1\n"
                                            "echo Id=stratalux-batch.timer; echo LoadState=not-found\n"),
                                    kBatchTimer);
  unsetenv("NOTIFY_SOCKET");
  EXPECT_EQ(timer.here, Here::kAbsent);
}

class FitsOfTest : public db::StoreTest {};

TEST_F(FitsOfTest, CountsVisitorsWithoutAFitAsTheRowsDo) {
  const auto rows = db::WriteIndexRows(folder_, {});
  int64_t without = 0;
  for (const auto& row : rows) {
    const bool usable =
        row.row.info.status == SessionStatus::kComplete || row.row.info.status == SessionStatus::kDegraded;
    without += row.row.info.kind == SessionKind::kVisitor && usable && row.fits.empty() ? 1 : 0;
  }
  ASSERT_GT(without, 0);
  const auto fits = FitsOf(folder_, WallNow());
  ASSERT_TRUE(fits.ok()) << fits.status().message();
  EXPECT_EQ(*fits, (FitFacts{without, false, 0, 0, 0}));
}

TEST_F(FitsOfTest, CountsTheJobsOfTheLastDay) {
  { const auto made = OpenStore(); }
  db::JobClock clock = *db::JobClock::OfThisMachine();
  clock.wall = [] { return WallNs{1'800'000'000'000'000'000}; };
  auto jobs = db::JobStore::Open(folder_, {clock});
  ASSERT_TRUE(jobs.ok()) << jobs.status().message();
  const auto lease = [&] {
    auto job = jobs->Lease({"a", {"fit"}, std::chrono::minutes(1)});
    return (*job)->token;
  };
  for (const char* key : {"a", "b", "c", "d", "e"}) ASSERT_TRUE(jobs->Enqueue({key, "fit"}).ok());
  ASSERT_TRUE(jobs->Enqueue({"board", "calibrate"}).ok());
  ASSERT_TRUE(jobs->Complete(lease()).ok());
  ASSERT_TRUE(jobs->Complete(lease()).ok());
  ASSERT_TRUE(jobs->Fail(lease(), "no light", std::nullopt).ok());
  const WallNs evening{1'800'000'000'000'000'000 + 3600 * kSecondNs};
  EXPECT_EQ(*FitsOf(folder_, evening), (FitFacts{0, true, 2, 2, 1}));
  EXPECT_EQ(*FitsOf(folder_, {evening.ns + 24 * 3600 * kSecondNs}), (FitFacts{0, true, 2, 0, 0}));
}

TEST(FitsOfAStore, ThatIsNotThereAreNone) {
  EXPECT_EQ(FitsOf("/nonexistent/store", {0}).status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace stratalux::rig
