// SPDX-License-Identifier: Apache-2.0
// A store of schema 1, as version 0.1 left it, opens for ever.
#include <fstream>
#include <sstream>

#include <gmock/gmock.h>

#include "db/base/sqlite.h"
#include "db/catalogue/read_only_index.h"
#include "db/catalogue/session_store.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;

std::string SchemaOne() {
  std::ifstream file(std::string(STRATALUX_SOURCE_DIR) + "/db/catalogue/migrations/0001_initial.sql");
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

// Two sessions, 30 frames, one calibration, one fit; frozen.
constexpr const char* kRowsOfSchemaOne = R"(
  INSERT INTO calibrations VALUES ('c0ffee', '{"source": "calibration session s000001-aaaaaaaa"}');
  INSERT INTO sessions VALUES (1, 's000001-aaaaaaaa', 'calibration', 'bench', '', '', 0, 0, 1000000000, 'complete', '[]',
                               '0.1.0', '', NULL);
  INSERT INTO sessions VALUES (2, 's000002-bbbbbbbb', 'visitor', 'bench', 'v7', 'text 3', 0, 0, 86401000000000, 'degraded',
                               '["no proven frame for step 3"]', '0.1.0', '{}', 'c0ffee');
  WITH RECURSIVE n (i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i < 29)
    INSERT INTO frames SELECT 1 + i / 20, i % 20, 1, 64 + 500 * i, 100 + i, x'00112233445566778899aabbccddeeff', i % 20, i % 4,
                              'sweep', 'white', 0, 1 FROM n;
  INSERT INTO fits VALUES ('f1', 2, '{}', '{"fit": {"divergence": 0.5}}', 86402000000000);
  INSERT INTO jobs VALUES (1, 2, 'fit', 'done', '{}', '');
)";

class MigrationTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    for (const char* name : {"index.sqlite", "index.sqlite-wal", "index.sqlite-shm"})
      std::filesystem::remove(folder_ / name);
    Connection connection = Open(Connection::Mode::kCreate);
    for (const std::string& sql : {std::string("PRAGMA journal_mode = WAL"), SchemaOne(), std::string(kRowsOfSchemaOne),
                                   std::string("PRAGMA application_id = 1397512241; PRAGMA user_version = 1")}) {
      const Status status = connection.Execute(sql);
      ASSERT_TRUE(status.ok()) << status.message();
    }
  }
  [[nodiscard]] Connection Open(Connection::Mode mode, const std::string& name = "index.sqlite") const {
    auto connection = Connection::Open(folder_ / name, mode);
    EXPECT_TRUE(connection.ok()) << connection.status().message();
    return std::move(connection).value();
  }
  static int64_t Integer(Connection& connection, const std::string& sql) {
    const auto value = connection.QueryInteger(sql);
    EXPECT_TRUE(value.ok()) << sql << ": " << value.status().message();
    return value.ok() ? *value : -1;
  }
  // Every cell of the columns that schema 1 has, as one text.
  static std::string Contents(Connection& connection) {
    std::string all;
    for (const char* columns :
         {"id, record_json FROM calibrations",
          "session, frame, segment, offset, stored_bytes, hex(hash), step, projector,"
          " phase, pattern, retry, level_check FROM frames",
          "id, session, options_json, metrics_json, created_wall_ns FROM"
          " fits",
          "id, session, kind, state, options_json, message FROM jobs",
          "number, id, kind, rig, visitor, consent, simulated, seed, started_wall_ns, status, reasons_json,"
          " program_version, plan_json, calibration_id FROM sessions"}) {
      auto select = connection.Prepare("SELECT " + std::string(columns) + " ORDER BY 1, 2");
      EXPECT_TRUE(select.ok()) << select.status().message();
      const auto count = std::count(columns, columns + std::string(columns).find(" FROM"), ',') + 1;
      while (*select->Step())
        for (int c = 0; c < count; ++c) all += select->Text(c) + "|";
    }
    return all;
  }
};

TEST_F(MigrationTest, KeepsEveryRowOfSchemaOne) {
  std::string before;
  {
    Connection old = Open(Connection::Mode::kReadOnly);
    before = Contents(old);
  }
  const auto store = SessionStore::Open(folder_, AccessMode::kReadOnly);
  ASSERT_TRUE(store.ok()) << store.status().message();
  Connection now = Open(Connection::Mode::kReadOnly);
  EXPECT_EQ(Integer(now, "PRAGMA user_version"), kSchemaVersion);
  EXPECT_EQ(Integer(now, "SELECT count(*) FROM pragma_integrity_check WHERE integrity_check <> 'ok'"), 0);
  EXPECT_EQ(Integer(now, "SELECT count(*) FROM pragma_foreign_key_check"), 0);
  EXPECT_EQ(Contents(now), before);
  EXPECT_GT(before.size(), 2000U);
}

TEST_F(MigrationTest, FillsWhatTheNewSchemaAdds) {
  ASSERT_TRUE(SessionStore::Open(folder_, AccessMode::kReadWrite).ok());
  Connection now = Open(Connection::Mode::kReadOnly);
  EXPECT_EQ(Integer(now, "SELECT frame_count FROM sessions WHERE number = 1"), 20);
  EXPECT_EQ(Integer(now, "SELECT frame_count FROM sessions WHERE number = 2"), 10);
  EXPECT_EQ(Integer(now, "SELECT stored_bytes FROM sessions WHERE number = 2"), 10 * 100 + (20 + 29) * 5);
  EXPECT_EQ(Integer(now, "SELECT count(*) FROM visitors WHERE id = 'v7'"), 1);
  EXPECT_EQ(
      Integer(now, "SELECT value * 100 FROM metrics WHERE session = 2 AND fit = 'f1' AND name = 'fit.divergence'"), 50);
  EXPECT_EQ(Integer(now, "SELECT since_wall_ns FROM calibration_overview WHERE id = 'c0ffee' AND rig = 'bench'"),
            1000000000)
      << "made by the session its source names";
}

TEST_F(MigrationTest, CountsTheStepsOfOldPlans) {
  PlanOptions options;
  options.guards = 3;
  const auto steps = static_cast<int64_t>(BuildPlan(options)->steps.size());
  {
    Connection old = Open(Connection::Mode::kReadWrite);
    ASSERT_TRUE(old.Execute("UPDATE sessions SET plan_json = '" + PlanOptionsToJson(options) +
                            "' WHERE number = 1; UPDATE sessions SET plan_json = 'no plan' WHERE number = 2")
                    .ok());
  }
  ASSERT_TRUE(SessionStore::Open(folder_, AccessMode::kReadWrite).ok());
  Connection now = Open(Connection::Mode::kReadOnly);
  EXPECT_EQ(Integer(now, "SELECT planned_steps FROM sessions WHERE number = 1"), steps);
  EXPECT_EQ(Integer(now, "SELECT planned_steps IS NULL FROM sessions WHERE number = 2"), 1);
}

TEST_F(MigrationTest, MakesABackupOfTheOldIndexFirst) {
  std::string before;
  {
    Connection old = Open(Connection::Mode::kReadOnly);
    before = Contents(old);
  }
  ASSERT_TRUE(SessionStore::Open(folder_, AccessMode::kReadWrite).ok());
  Connection backup = Open(Connection::Mode::kReadOnly, "index-before-" + std::to_string(kSchemaVersion) + ".sqlite");
  EXPECT_EQ(Integer(backup, "PRAGMA user_version"), 1);
  EXPECT_EQ(Contents(backup), before);
}

TEST_F(MigrationTest, LeavesTheOldSchemaWhenItFailsHalfWay) {
  std::string before;
  {
    // Schema 2 goes in whole; then the name of one of schema 3's views is taken.
    Connection old = Open(Connection::Mode::kReadWrite);
    ASSERT_TRUE(old.Execute("CREATE TABLE frame_overview (a)").ok());
    before = Contents(old);
  }
  const auto store = SessionStore::Open(folder_, AccessMode::kReadWrite);
  ASSERT_FALSE(store.ok());
  EXPECT_THAT(store.status().message(), HasSubstr("frame_overview"));
  Connection now = Open(Connection::Mode::kReadWrite);
  EXPECT_EQ(Integer(now, "PRAGMA user_version"), 1);
  EXPECT_EQ(Integer(now, "SELECT count(*) FROM sqlite_schema WHERE name IN ('visitors', 'proofs', 'fit_overview')"), 0);
  EXPECT_EQ(Contents(now), before);
  // What stood in the way gone, it migrates: the backup of the first attempt is no obstacle.
  ASSERT_TRUE(now.Execute("DROP TABLE frame_overview").ok());
  const auto again = SessionStore::Open(folder_, AccessMode::kReadWrite);
  EXPECT_TRUE(again.ok()) << again.status().message();
}

TEST_F(MigrationTest, RefusesANewerSchema) {
  ASSERT_TRUE(Open(Connection::Mode::kReadWrite).Execute("PRAGMA user_version = 99").ok());
  EXPECT_EQ(SessionStore::Open(folder_, AccessMode::kReadOnly).status().code(), StatusCode::kNewerSchema);
  EXPECT_EQ(ReadOnlyIndex::Open(folder_).status().exit_code(), 7);
}

}  // namespace
}  // namespace stratalux::db
