// SPDX-License-Identifier: Apache-2.0
// What is due, and when.
#include "db/privacy/retention.h"

#include <gmock/gmock.h>

#include "db/care/incoming.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/read_only_index.h"
#include "db/ledger/ledger.h"
#include "db/privacy/disclosure.h"
#include "tests/db/privacy/raw_bytes.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
constexpr int64_t kDay = int64_t{86'400} * 1'000'000'000;

class RetentionTest : public StoreTest {
 protected:
  std::string Store(SessionInfo info) const {
    SessionStore store = OpenStore();
    auto writer = store.BeginSession(std::move(info));
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    EXPECT_TRUE(AppendTo(*writer, 0).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    return writer->info().id;
  }
  std::string StoreClass(Retention retention) const {
    SessionInfo info = SimulatedVisit();
    info.retention = retention;
    return Store(info);
  }
  [[nodiscard]] std::vector<std::string> DueAfter(int64_t days, const RetentionDays& classes = {}) const {
    std::vector<std::string> ids;
    const auto due = DueSessions(folder_, classes, {WallNow().ns + days * kDay});
    EXPECT_TRUE(due.ok()) << due.status().message();
    for (const DueSession& session : *due) ids.push_back(session.id);
    return ids;
  }
};

TEST_F(RetentionTest, EachClassIsDueAfterItsDaysAndNotBefore) {
  const std::string brief = StoreClass(Retention::kShort), standard = StoreClass(Retention::kStandard),
                    lasting = StoreClass(Retention::kLong), kept = StoreClass(Retention::kKeep);
  EXPECT_THAT(DueAfter(29), IsEmpty());
  EXPECT_THAT(DueAfter(30), ::testing::ElementsAre(brief));
  EXPECT_THAT(DueAfter(364), ::testing::ElementsAre(brief));
  EXPECT_THAT(DueAfter(365), ::testing::ElementsAre(brief, standard));
  EXPECT_THAT(DueAfter(3650), ::testing::ElementsAre(brief, standard, lasting));
  EXPECT_THAT(DueAfter(36500), ::testing::Not(::testing::Contains(kept)));
  EXPECT_THAT(DueAfter(7, {7, 8, 9}), ::testing::ElementsAre(brief));
  EXPECT_THAT(DueAfter(0, {0, 1, 1}), ::testing::ElementsAre(brief));
}

TEST_F(RetentionTest, AClockThatWasWrongMakesNothingDue) {
  StoreClass(Retention::kShort);
  EXPECT_THAT(DueAfter(-1, {0, 0, 0}), IsEmpty()) << "a session of the future";
  EXPECT_THAT(DueAfter(-10000), IsEmpty());
}

TEST_F(RetentionTest, SessionsThatShowNobodyAreNeverDue) {
  SessionInfo info;
  info.kind = SessionKind::kCalibration;
  info.retention = Retention::kShort;
  Store(info);
  EXPECT_THAT(DueAfter(80000), IsEmpty());
}

TEST_F(RetentionTest, AWithdrawnConsentIsDueAtOnceWhateverTheClass) {
  Consent consent{"1", "de", true, false, false, {}};
  ASSERT_TRUE(GiveConsent(folder_, "v-1", consent).ok());
  ASSERT_TRUE(GiveConsent(folder_, "v-2", consent).ok());
  SessionInfo info;
  info.visitor = "v-1";
  info.retention = Retention::kKeep;
  const std::string mine = Store(info);
  info.visitor = "v-2";
  Store(info);
  ASSERT_TRUE(WithdrawConsent(folder_, "v-1").ok());
  EXPECT_THAT(DueAfter(0), ::testing::ElementsAre(mine));
  const auto due = DueSessions(folder_, {}, WallNow());
  EXPECT_THAT(due->front().reason, HasSubstr("withdrawn"));
  // A new consent is for new sessions.
  ASSERT_TRUE(GiveConsent(folder_, "v-1", consent).ok());
  info.visitor = "v-1";
  Store(info);
  EXPECT_THAT(DueAfter(0), ::testing::ElementsAre(mine));
}

// What a pull that was broken off left of a source that never comes back.
class LeftoverTest : public RetentionTest {
 protected:
  void SetUp() override {
    RetentionTest::SetUp();
    ASSERT_TRUE(SessionStore::Open(folder_, AccessMode::kReadWrite).ok());
  }
  static void Lay(const std::filesystem::path& folder, const std::string& id, Retention retention,
                  SessionKind kind = SessionKind::kVisitor) {
    std::filesystem::create_directories(folder);
    SessionInfo info;
    info.id = id;
    info.kind = kind;
    info.visitor = "v-1";
    info.retention = retention;
    info.started_wall = WallNow();
    ASSERT_TRUE(WriteManifest(folder, info, 0, {}).ok());
  }
  [[nodiscard]] std::vector<std::string> LeftAfter(int64_t days, const RetentionDays& classes = {}) const {
    std::vector<std::string> ids;
    const auto due = DueIncoming(folder_, classes, {WallNow().ns + days * kDay});
    EXPECT_TRUE(due.ok()) << due.status().message();
    for (const DueSession& session : due->sessions) ids.push_back(session.id);
    return ids;
  }
};

TEST_F(LeftoverTest, AgesAsItsSessionWould) {
  Lay(IncomingFolder(folder_, "s1-a"), "s1-a", Retention::kShort);
  Lay(IncomingFolder(folder_, "s2-b"), "s2-b", Retention::kStandard);
  Lay(IncomingFolder(folder_, "s3-c"), "s3-c", Retention::kKeep);
  Lay(IncomingFolder(folder_, "s4-d"), "s4-d", Retention::kShort, SessionKind::kCalibration);
  EXPECT_THAT(LeftAfter(29), IsEmpty());
  EXPECT_THAT(LeftAfter(30), ::testing::ElementsAre("s1-a"));
  EXPECT_THAT(LeftAfter(36500), ::testing::ElementsAre("s1-a", "s2-b"));
  EXPECT_THAT(LeftAfter(-1, {0, 0, 0}), IsEmpty()) << "of the future";
  EXPECT_THAT(DueAfter(36500), IsEmpty()) << "no session of the index";
}

TEST_F(LeftoverTest, WithoutAManifestTheOneThatThePullKeptCountsElseTheShortestClass) {
  std::filesystem::create_directories(IncomingFolder(folder_, "s1-a"));
  WriteText(IncomingFolder(folder_, "s1-a") / "frames-0001.seg", "a face");
  Lay(IncomingSources(folder_) / "x" / "sessions" / "s1-a", "s1-a", Retention::kLong);
  std::filesystem::create_directories(IncomingFits(folder_, "s2-b") / "f1");
  WriteText(IncomingFits(folder_, "s2-b") / "f1" / "mesh.ply", "a face");
  EXPECT_THAT(LeftAfter(29), IsEmpty());
  EXPECT_THAT(LeftAfter(31), ::testing::ElementsAre("s2-b"));
  EXPECT_THAT(LeftAfter(3651), ::testing::ElementsAre("s1-a", "s2-b"));
  EXPECT_THAT(LeftAfter(8, {30, 7, 900}), ::testing::ElementsAre("s2-b"));
}

TEST_F(LeftoverTest, AManifestThatAPullKeptOfASessionItNeverTookAgesToo) {
  Lay(IncomingSources(folder_) / "x" / "sessions" / "s1-a", "s1-a", Retention::kShort);
  const std::string here = StoreClass(Retention::kShort);
  Lay(IncomingSources(folder_) / "x" / "sessions" / here, here, Retention::kShort);
  EXPECT_THAT(LeftAfter(29), IsEmpty());
  EXPECT_THAT(LeftAfter(31), ::testing::ElementsAre("s1-a")) << "the other goes with its session";
}

TEST_F(LeftoverTest, AWithdrawalMakesItDueWhateverItsClass) {
  Lay(IncomingFolder(folder_, "s1-a"), "s1-a", Retention::kKeep);
  ASSERT_TRUE(AppendToLedger(folder_, {LedgerKind::kWithdrawal, WallNow(), {"s1-a"}, "", ""}).ok());
  EXPECT_THAT(LeftAfter(0), ::testing::ElementsAre("s1-a"));
}

// Killed between the ledger's entry and the index.
TEST_F(RetentionTest, AWithdrawalThatStandsInTheLedgerAloneIsDueAndHidesThePictures) {
  ASSERT_TRUE(GiveConsent(folder_, "v-1", {"1", "de", true, false, false, {}}).ok());
  SessionInfo info;
  info.visitor = "v-1";
  info.retention = Retention::kKeep;
  const std::string mine = Store(info);
  KeptLedger ledger(folder_);
  const auto shown = [&] {
    auto index = ReadOnlyIndex::Open(folder_);
    return index.ok() ? MayBeShown(ledger, *index, mine) : index.status();
  };
  EXPECT_TRUE(shown().ok()) << shown().message();
  EXPECT_THAT(DueAfter(0), IsEmpty());
  ASSERT_TRUE(AppendToLedger(folder_, {LedgerKind::kWithdrawal, WallNow(), {mine}, "", ""}).ok());
  EXPECT_EQ(shown().code(), StatusCode::kUsage);
  ASSERT_THAT(DueAfter(0), ::testing::ElementsAre(mine));
  EXPECT_THAT(DueSessions(folder_, {}, WallNow())->front().reason, HasSubstr("withdrawn"));
}

// A session that its entry does not name, made under the same consent: the index alone tells, once it follows.
TEST_F(RetentionTest, APurgeFollowsTheLedgerFirst) {
  ASSERT_TRUE(GiveConsent(folder_, "v-1", {"1", "de", true, false, false, {7'000}}).ok());
  SessionInfo info;
  info.visitor = "v-1";
  info.consent = {"1", "de", true, false, false, {7'000}};
  const std::string mine = Store(info);
  ASSERT_TRUE(AppendToLedger(folder_, {LedgerKind::kWithdrawal, WallNow(), {}, "", WithdrawalDetail({{7'000}})}).ok());
  const Outcome purged = Execute("stratalux-db purge --store " + folder_.string());
  EXPECT_EQ(purged.code, 0) << purged.out;
  EXPECT_THAT(purged.out, HasSubstr(mine + ": gone"));
}

TEST_F(LeftoverTest, TheManifestOfANewerProgramMakesNothingDueAndIsNamed) {
  Lay(IncomingFolder(folder_, "s1-a"), "s1-a", Retention::kKeep);
  WriteText(IncomingFolder(folder_, "s1-a") / "manifest.json", R"({"schema": 4711})");
  EXPECT_THAT(LeftAfter(36500), IsEmpty());
  const auto due = DueIncoming(folder_, {}, {WallNow().ns + 36500 * kDay});
  ASSERT_TRUE(due.ok()) << due.status().message();
  EXPECT_THAT(due->newer, ::testing::ElementsAre(::testing::AllOf(HasSubstr("s1-a"), HasSubstr("newer"))));
  const Outcome purged = Execute("stratalux-db purge --now 2150-01-01 --store " + folder_.string());
  EXPECT_EQ(purged.code, 0) << purged.out;
  EXPECT_THAT(purged.out, HasSubstr("of a newer program, not purged"));
  EXPECT_TRUE(std::filesystem::exists(IncomingFolder(folder_, "s1-a")));
  ASSERT_TRUE(AppendToLedger(folder_, {LedgerKind::kWithdrawal, WallNow(), {"s1-a"}, "", ""}).ok());
  EXPECT_THAT(LeftAfter(0), ::testing::ElementsAre("s1-a")) << "withdrawn, whatever it is";
}

}  // namespace
}  // namespace stratalux::db
