// SPDX-License-Identifier: Apache-2.0
// What a question for one session costs does not grow with the store: no selector walks `sessions` or `frames`.
#include <set>

#include <gmock/gmock.h>
#include <sqlite3.h>

#include "db/apps/session_views.h"
#include "db/base/sqlite.h"
#include "db/care/verify.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/session_index.h"
#include "db/privacy/retention.h"
#include "tests/db/index_rows.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

// Rows of many sessions, and one with its files behind them.
class SelectorTest : public StoreTest {
 protected:
  std::string Fill(int sessions) {
    StoreTest::TearDown();
    std::filesystem::create_directories(folder_);
    WriteIndexRows(folder_, {.sessions = sessions, .frames_per_session = 20});
    EXPECT_TRUE(GiveConsent(folder_, "v-1", {"1", "de", true, false, false, {}}).ok());
    SessionStore store = OpenStore();
    SessionInfo info;
    info.visitor = "v-1";
    auto writer = store.BeginSession(info);
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < 20; ++i) EXPECT_TRUE(AppendTo(*writer, i).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    EXPECT_TRUE(WithdrawConsent(folder_, "v-1").ok());
    return writer->info().id;
  }
  template <typename Question>
  static StatementWork WorkOf(const Question& question) {
    const StatementWork before = WorkOfThisThread();
    question();
    const StatementWork after = WorkOfThisThread();
    return {after.scanned_rows - before.scanned_rows, after.steps - before.steps};
  }
};

TEST_F(SelectorTest, CostsTheSameInALargeStore) {
  std::map<std::string, StatementWork> small, large;
  for (const int sessions : {100, 600}) {
    const std::string id = Fill(sessions);
    auto& work = sessions == 100 ? small : large;
    const auto open = [this] { return OpenStore(AccessMode::kReadOnly); };
    work["open"] = WorkOf([&] { (void)open(); });
    work["open to write"] = WorkOf([&] { (void)OpenStore(); });
    for (const std::string& selector : {id, id.substr(0, 9), std::string("latest"), std::string("nobody")})
      work["find " + selector.substr(0, 1)] = WorkOf([&] {
        const auto row = open().FindSession(selector);
        EXPECT_EQ(row.ok(), selector != "nobody");
        if (row.ok()) {
          EXPECT_EQ(row->info.id, id);
        }
      });
    work["ambiguous"] = WorkOf([&] { EXPECT_EQ(open().FindSession("s").status().code(), StatusCode::kUsage); });
    work["show"] = WorkOf([&] { EXPECT_TRUE(LoadDetails(open(), "latest").ok()); });
    work["frames"] = WorkOf([&] { EXPECT_EQ(open().ListFrames(id)->size(), 20U); });
    work["verify ID"] = WorkOf([&] {
      const SessionStore store = open();
      EXPECT_TRUE(VerifySession(store, *store.FindSession(id)).ok());
    });
    // The rows' sessions end before `now` of the rows; nothing of them is due on the first day of the epoch.
    work["due"] = WorkOf([&] { EXPECT_EQ(DueSessions(folder_, {}, {1})->size(), 1U); });
    work["of a visitor"] = WorkOf([&] { EXPECT_EQ(open().ListSessionsOf("v-1")->size(), 1U); });
  }
  for (const auto& [name, work] : large) {
    EXPECT_LE(work.scanned_rows, 5) << name;
    // A search goes a level deeper at most, which SQLite does not count as a step.
    EXPECT_LE(work.steps, small[name].steps + 20) << name;
  }
  EXPECT_GT(WorkOf([&] { (void)OpenStore().ListSessions().ok(); }).steps, 5'000) << "the measure measures";
}

// What the statements of every connection cost, those of the read-only index, too.
StatementWork profiled;
int CountProfile(unsigned, void*, void* statement, void*) {
  auto* of = static_cast<sqlite3_stmt*>(statement);
  profiled.scanned_rows += sqlite3_stmt_status(of, SQLITE_STMTSTATUS_FULLSCAN_STEP, 1);
  profiled.steps += sqlite3_stmt_status(of, SQLITE_STMTSTATUS_VM_STEP, 1);
  return 0;
}
int ProfileConnection(sqlite3* connection) {
  return sqlite3_trace_v2(connection, SQLITE_TRACE_PROFILE, CountProfile, nullptr);
}

TEST_F(SelectorTest, ShowAsksTheViewsForItsSessionAlone) {
  std::vector<StatementWork> works;
  for (const int sessions : {100, 600}) {
    const std::string id = Fill(sessions);
    sqlite3_auto_extension(reinterpret_cast<void (*)()>(ProfileConnection));
    profiled = {};
    const auto details = LoadDetails(OpenStore(AccessMode::kReadOnly), id);
    sqlite3_cancel_auto_extension(reinterpret_cast<void (*)()>(ProfileConnection));
    ASSERT_TRUE(details.ok()) << details.status().message();
    EXPECT_EQ(details->due_reason, "consent withdrawn");
    works.push_back(profiled);
  }
  EXPECT_GT(works[0].steps, 100) << "the measure measures";
  EXPECT_LE(works[1].scanned_rows, works[0].scanned_rows + 5);
  EXPECT_LE(works[1].steps, works[0].steps + 50);
}

int Collect(unsigned, void* queries, void* statement, void*) {
  static_cast<std::set<std::string>*>(queries)->insert(sqlite3_sql(static_cast<sqlite3_stmt*>(statement)));
  return 0;
}

TEST_F(SelectorTest, NoPlanScansSessionsOrFrames) {
  const std::string id = Fill(100);
  auto index = SessionIndex::Open(folder_, AccessMode::kReadOnly);
  ASSERT_TRUE(index.ok());
  Connection& connection = index->connection();
  std::set<std::string> queries;
  sqlite3_trace_v2(connection.handle(), SQLITE_TRACE_STMT, Collect, &queries);
  for (const std::string& selector :
       {id, id.substr(0, 8), std::string("latest"), std::string("s"), std::string("\xff")})
    ASSERT_TRUE(index->Select(selector).ok());
  const int64_t number = *index->NumberOf(id);
  EXPECT_TRUE(index->Session(number).ok() && index->Recording().ok() && index->HasUnfinished().ok() &&
              index->Places(number).ok() && index->Fits(number, id).ok() && index->SessionsOf("v-1").ok());
  sqlite3_trace_v2(connection.handle(), 0, nullptr, nullptr);
  EXPECT_GE(queries.size(), 10U);
  for (const std::string& query : queries) {
    if (query.starts_with("PRAGMA")) continue;
    auto plan = connection.Prepare("EXPLAIN QUERY PLAN " + query);
    ASSERT_TRUE(plan.ok()) << query;
    while (*plan->Step()) {
      // The partial index holds the few that are recorded.
      if (plan->Text(3).find("sessions_recording") != std::string::npos) continue;
      EXPECT_THAT(plan->Text(3), Not(HasSubstr("SCAN"))) << query;
    }
  }
}

TEST_F(SelectorTest, FindsWhatItAlwaysFound) {
  const std::string id = Fill(100);
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  const auto all = *store.ListSessions();
  ASSERT_EQ(all.size(), 101U);
  for (const SessionSummary& row : all) {
    const auto found = store.FindSession(row.info.id);
    ASSERT_TRUE(found.ok());
    EXPECT_EQ(found->frames, row.frames);
    EXPECT_TRUE(row.info.plan_json.empty() && row.info.calibration_json.empty());
  }
  EXPECT_FALSE(store.FindSession(all[5].info.id)->info.plan_json.empty());
  // By hand: every prefix of an id.
  for (size_t length = 1; length <= id.size(); ++length) {
    const std::string prefix = id.substr(0, length);
    const auto matches =
        std::count_if(all.begin(), all.end(), [&](const auto& row) { return row.info.id.starts_with(prefix); });
    const auto found = store.FindSession(prefix);
    EXPECT_EQ(found.ok(), matches == 1) << prefix;
    if (!found.ok()) {
      EXPECT_EQ(found.status().code(), StatusCode::kUsage) << prefix;
    }
  }
  for (const char* nobody : {"", "t", "s999999", "\xff\xff", "%", "s%", "_"})
    EXPECT_EQ(store.FindSession(nobody).status().code(), StatusCode::kNotFound) << nobody;
}

}  // namespace
}  // namespace stratalux::db
