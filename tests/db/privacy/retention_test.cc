// SPDX-License-Identifier: Apache-2.0
// What is due, and when.
#include "db/privacy/retention.h"

#include <gmock/gmock.h>

#include "db/catalogue/consent.h"
#include "tests/db/privacy/raw_bytes.h"
#include "tests/db/store_fixture.h"

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
  EXPECT_THAT(DueAfter(100000), IsEmpty());
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

}  // namespace
}  // namespace stratalux::db
