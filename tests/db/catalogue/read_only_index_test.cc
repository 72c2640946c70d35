// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/read_only_index.h"

#include <gmock/gmock.h>

#include "db/base/sqlite.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;

class ReadOnlyIndexTest : public StoreTest {
 protected:
  [[nodiscard]] ReadOnlyIndex OpenIndex() const {
    auto index = ReadOnlyIndex::Open(folder_);
    EXPECT_TRUE(index.ok()) << index.status().message();
    return std::move(index).value();
  }
};

TEST_F(ReadOnlyIndexTest, NoStatementChangesTheStore) {
  StoreSession(3);
  const auto before = ReadBytes(folder_ / "index.sqlite");
  ReadOnlyIndex index = OpenIndex();
  const std::string elsewhere = (folder_ / "elsewhere.sqlite").string();
  const std::vector<std::string> writes = {
      "INSERT INTO job_fence (one, last) VALUES (2, 1)",
      "INSERT INTO sessions SELECT * FROM sessions",
      "WITH a AS (SELECT 1) INSERT INTO visitors SELECT 'x', 1",
      "INSERT INTO visitors VALUES ('x', 1) RETURNING id",
      "UPDATE sessions SET status = 'complete'",
      "DELETE FROM sessions",
      "REPLACE INTO visitors VALUES ('x', 1)",
      "DROP TABLE frames",
      "ALTER TABLE frames RENAME TO gone",
      "CREATE TABLE t (a)",
      "CREATE TEMP TABLE t (a)",
      "CREATE VIEW v AS SELECT 1",
      "CREATE INDEX i ON sessions (rig)",
      "PRAGMA user_version = 99",
      "PRAGMA user_version",
      "PRAGMA query_only = OFF",
      "PRAGMA writable_schema = ON",
      "PRAGMA journal_mode = DELETE",
      "SELECT * FROM pragma_journal_mode('DELETE')",
      "ATTACH '" + elsewhere + "' AS other",
      "DETACH main",
      "VACUUM",
      "VACUUM INTO '" + elsewhere + "'",
      "REINDEX",
      "ANALYZE",
      "BEGIN IMMEDIATE",
      "SAVEPOINT a",
      "COMMIT",
      "SELECT load_extension('/tmp/x')",
      "SELECT 1; DROP TABLE frames",
      "SELECT 1; SELECT 2",
      "EXPLAIN DELETE FROM frames",
  };
  for (const std::string& sql : writes) {
    const auto answer = index.Run(sql);
    ASSERT_FALSE(answer.ok()) << sql;
    EXPECT_EQ(answer.status().code(), StatusCode::kUsage) << sql << ": " << answer.status().message();
  }
  EXPECT_EQ(ReadBytes(folder_ / "index.sqlite"), before);
  EXPECT_FALSE(std::filesystem::exists(elsewhere));
  EXPECT_EQ(std::get<int64_t>(index.Run("SELECT count(*) FROM frames")->rows[0][0]), 3);
}

TEST_F(ReadOnlyIndexTest, SaysWhatItRefuses) {
  ReadOnlyIndex index = OpenIndex();
  EXPECT_THAT(index.Run("DELETE FROM frames").status().message(), HasSubstr("DELETE frames is refused"));
  EXPECT_THAT(index.Run("SELECT * FROM face").status().message(), HasSubstr("no such table: face"));
  EXPECT_THAT(index.Run(" -- nothing").status().message(), HasSubstr("no statement"));
}

TEST_F(ReadOnlyIndexTest, StopsWhatDoesNotEnd) {
  ReadOnlyIndex index = OpenIndex();
  QueryLimits limits;
  limits.time = std::chrono::milliseconds(50);
  const auto endless =
      index.Run("WITH RECURSIVE c (x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT count(*) FROM c", {}, limits);
  ASSERT_FALSE(endless.ok());
  EXPECT_EQ(endless.status().code(), StatusCode::kFailed);
  EXPECT_THAT(endless.status().message(), HasSubstr("50 ms"));
  EXPECT_EQ(std::get<int64_t>(index.Run("SELECT 7")->rows[0][0]), 7) << "the next question is answered";
}

TEST_F(ReadOnlyIndexTest, BoundsTheAnswer) {
  ReadOnlyIndex index = OpenIndex();
  const std::string numbers = "WITH RECURSIVE c (x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT x FROM c";
  QueryLimits limits;
  limits.rows = 5;
  const auto cut = index.Run(numbers, {}, limits);
  ASSERT_TRUE(cut.ok()) << cut.status().message();
  EXPECT_EQ(cut->rows.size(), 5U);
  EXPECT_TRUE(cut->truncated);
  EXPECT_FALSE(index.Run(numbers + " LIMIT 5", {}, limits)->truncated) << "exactly as many as there are";
  limits = {};
  limits.bytes = 10'000;
  const auto wide = index.Run(
      "WITH RECURSIVE c (x) AS (SELECT zeroblob(4000) UNION ALL SELECT x FROM c) SELECT x FROM c", {}, limits);
  EXPECT_EQ(wide->rows.size(), 3U);
  EXPECT_TRUE(wide->truncated);
  EXPECT_EQ(index.Run("SELECT zeroblob(1000000000)").status().code(), StatusCode::kUsage);
}

TEST_F(ReadOnlyIndexTest, KeepsTypesAndBytes) {
  ReadOnlyIndex index = OpenIndex();
  const std::string hostile("a\0\xff,\"\n", 6);
  const auto table = index.Run("SELECT NULL, -5, 0.5, :text, x'00ff', :missing", {{"text", hostile}});
  ASSERT_TRUE(table.ok()) << table.status().message();
  const std::vector<Cell> expected = {std::monostate(), int64_t{-5}, 0.5, hostile, Blob{0, 255}, std::monostate()};
  EXPECT_EQ(table->rows[0], expected);
}

TEST_F(ReadOnlyIndexTest, NoValueOrStatementIsLongEnoughToHoldItUp) {
  ReadOnlyIndex index = OpenIndex();
  QueryLimits limits;
  limits.time = std::chrono::seconds(2);
  const auto code = [&](const std::string& sql) { return index.Run(sql, {}, limits).status().code(); };
  for (const char* sql : {"SELECT zeroblob(20000000)", "SELECT hex(zeroblob(10000000))", "SELECT randomblob(20000000)",
                          "SELECT replace(hex(zeroblob(4000)), '0', hex(zeroblob(9000)))"})
    EXPECT_EQ(code(sql), StatusCode::kUsage) << sql;
  EXPECT_EQ(code("SELECT " + std::string(2 << 20, '1')), StatusCode::kUsage) << "the statement itself";
  const auto start = std::chrono::steady_clock::now();
  for (const char* sql :
       {"WITH RECURSIVE c (x) AS (SELECT randomblob(1000000) UNION ALL SELECT randomblob(1000000) FROM c)"
        " SELECT count(*) FROM c",
        "WITH RECURSIVE c (x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT sum(length(hex(zeroblob(1000000)))) "
        "FROM c"})
    EXPECT_EQ(code(sql), StatusCode::kFailed) << sql;
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(10));
}

TEST_F(ReadOnlyIndexTest, MemoryEndsWhereItsLimitIs) {
  ReadOnlyIndex index = OpenIndex();
  QueryLimits limits;
  limits.time = std::chrono::seconds(60);
  // Sorted, hence kept: 100 GB if it could.
  const auto sorted = index.Run(
      "WITH RECURSIVE c (n, x) AS (SELECT 1, zeroblob(1000000) UNION ALL SELECT n + 1, zeroblob(1000000) FROM c WHERE "
      "n <"
      " 100000) SELECT length(x) FROM c ORDER BY n DESC, x",
      {}, limits);
  EXPECT_EQ(sorted.status().code(), StatusCode::kFailed);
  EXPECT_NE(sorted.status().message().find("512 MiB"), std::string::npos) << sorted.status().message();
  std::string wide = "SELECT 1";
  for (int i = 0; i < 200; ++i) wide += ", zeroblob(10000000 + " + std::to_string(i) + ")";
  EXPECT_EQ(index.Run(wide, {}, limits).status().code(), StatusCode::kFailed) << "a single row of 2 GB";
  EXPECT_TRUE(index.Run("SELECT 1").ok()) << "the next question is answered";
}

// reason_class of the view session_reasons, with nothing but replace().
TEST_F(ReadOnlyIndexTest, GroupsReasonsThatDifferInNumbers) {
  StoreSession(1);
  ASSERT_TRUE(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)
                  ->Execute("UPDATE sessions SET status = 'degraded', reasons_json = '[\"no frame for steps 3, 17 and"
                            " 12.5 % of 1/2.\", \"1.2.3 4..5 /6/ 007\", \"\", \"none\"]'")
                  .ok());
  ReadOnlyIndex index = OpenIndex();
  const auto table = index.Run("SELECT DISTINCT reason_class FROM session_reasons");
  std::vector<std::string> classes;
  for (const auto& row : table->rows) classes.push_back(std::get<std::string>(row[0]));
  EXPECT_EQ(classes, (std::vector<std::string>{"no frame for steps N, N and N % of N.", "N N..N /N/ N", "", "none"}));
}

}  // namespace
}  // namespace stratalux::db
