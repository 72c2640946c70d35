// SPDX-License-Identifier: Apache-2.0
// The index in the hands of other programs: what `stratalux-db` answers, sqlite3's own shell answers too.
#include <algorithm>
#include <cmath>
#include <map>
#include <sstream>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/base/sqlite.h"
#include "db/catalogue/named_query.h"
#include "tests/db/index_rows.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

class SqliteShell : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directory(folder_);
    WriteIndexRows(folder_, {.sessions = 60, .frames_per_session = 60, .seed = 5});
    // One of all that those rows lack.
    auto index = *Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
    const Status status = index.Execute(R"(
      INSERT INTO consents (visitor, text_version, language, fit, research, publication, given_wall_ns, withdrawn_wall_ns)
        SELECT id, '3', 'de', 1, rowid % 2, 0, 1700000000123456789, CASE WHEN rowid % 3 = 0 THEN 1750000000000000001 END
        FROM visitors;
      UPDATE sessions SET consent_json = '', consent = '' WHERE number % 5 = 0;
      UPDATE sessions SET retention = CASE number % 4 WHEN 0 THEN 'short' WHEN 1 THEN 'keep' ELSE retention END;
      UPDATE sessions SET reasons_json = '["step 3 of 300 dark", "lamp 0.5"]' WHERE status = 'degraded' AND number % 2 = 0;
      UPDATE sessions SET faults_json = '{"lost frame": 2, "late frame": 1}', findings_json =
        '[{"kind": "moved", "projector": 2, "step": 117, "value": 0.0625, "limit": 0.03},
          {"kind": "device", "value": 0.0, "limit": 0.0, "detail": "/dev/video0: gone"}]' WHERE number % 3 = 0;
      INSERT INTO access_log (at_wall_ns, who, action, session_id, detail) VALUES (1700000000000000007, 'ada', 'export', 's', '/x');
      INSERT INTO jobs (key, session, kind, state, priority, options_json, created_wall_ns, not_before_wall_ns, attempts,
                        max_attempts, owner, fence, boot, until_boot_ns, last_error, finished_wall_ns)
        VALUES ('a', 1, 'fit', 'queued', 0, '{}', 1700000000000000007, 0, 0, 3, '', 0, '', 0, '', NULL),
               ('b', NULL, 'fit', 'set-aside', -1, '{}', 1, 2, 3, 3, 'bench:7', 8, 'boot', 9, 'lens cap', 1750000000000000001);
      INSERT INTO accepted_calibrations (session, fit, calibration_id, made_wall_ns, valid_until_wall_ns)
        SELECT f.session, f.id, s.calibration_id, f.created_wall_ns, f.created_wall_ns + 86400000000000
        FROM fits f JOIN sessions s ON s.number = f.session WHERE s.calibration_id IS NOT NULL GROUP BY s.calibration_id;)");
    ASSERT_TRUE(status.ok()) << status.message();
    input_ = folder_.string() + "/statement.sql";
  }
  [[nodiscard]] Outcome Ours(const std::string& arguments) const {
    return Shell("STRATALUX_STORE=" + folder_.string() + " " + STRATALUX_BIN_DIR + "/stratalux-db " + arguments +
                 " < " + input_);
  }
  // sqlite3 with nothing of ours but the file. Its parameters are NULL unless they are set.
  [[nodiscard]] Outcome Theirs(const std::string& flags, const std::string& commands) const {
    WriteText(input_, commands);
    return Shell("sqlite3 -bail -readonly " + flags + " " + folder_.string() + "/index.sqlite < " + input_ + " 2>&1");
  }
  [[nodiscard]] std::vector<std::string> Views() const {
    std::vector<std::string> names;
    std::istringstream lines(Theirs("", "SELECT name FROM sqlite_schema WHERE type = 'view' ORDER BY name;\n").out);
    for (std::string name; std::getline(lines, name);) names.push_back(name);
    return names;
  }

  std::string input_;
};

std::string WithoutCarriageReturns(std::string text) {
  std::erase(text, '\r');
  return text;
}

TEST_F(SqliteShell, GivesTheSameRowsOfEveryView) {
  const auto views = Views();
  ASSERT_GE(views.size(), 15U);
  for (const std::string& view : views) {
    // Every cell as an SQL literal, a row as its hexadecimal digits: the same in any program's CSV.
    std::istringstream columns(Theirs("", "SELECT name FROM pragma_table_info('" + view + "');\n").out);
    std::string row;
    for (std::string name; std::getline(columns, name);)
      row += (row.empty() ? "" : " || '|' || ") + ("quote(\"" + name + "\")");
    const std::string sql = "SELECT hex(" + row + ") AS line FROM " + view + " ORDER BY line";
    const Outcome theirs = Theirs("-csv -header", sql + ";\n");
    WriteText(input_, sql);
    const Outcome ours = Ours("sql - --csv --limit 100000");
    EXPECT_EQ(theirs.code, 0) << view << ": " << theirs.out;
    EXPECT_EQ(ours.code, 0) << view;
    EXPECT_TRUE(WithoutCarriageReturns(theirs.out) == WithoutCarriageReturns(ours.out)) << view;
    EXPECT_GT(std::count(ours.out.begin(), ours.out.end(), '\n'), 1) << view << " shows nothing: the test is empty";
  }
}

// Their integers are our times; both print reals in their own number of digits.
void ExpectEqualCells(const Json& theirs, const Json& ours, const QueryColumn& column, const std::string& where) {
  if (column.kind == "time" && theirs.is_number()) {
    EXPECT_EQ(ToIso8601({theirs.get<int64_t>()}), ours.get<std::string>()) << where;
  } else if (theirs.is_number_float() || ours.is_number_float()) {
    EXPECT_NEAR(theirs.get<double>(), ours.get<double>(), 1e-12 * std::abs(ours.get<double>()) + 1e-15) << where;
  } else {
    EXPECT_EQ(theirs, ours) << where;
  }
}

TEST_F(SqliteShell, GivesTheSameAnswerToEveryNamedQuery) {
  const int64_t now_ns = 1'800'000'000'000'000'000;  // 2027-01-15T08:00:00Z, of the rows
  struct Span {
    const char *flags, *parameters;
  };
  const std::map<std::string, Span> spans = {
      {"since", {" --since 2027-01-01", ".parameter set :since_ns 1798761600000000000\n"}},
      {"until", {" --until 2027-01-14", ".parameter set :until_ns 1799884800000000000\n"}},
      {"rig", {" --rig kiosk-1", ".parameter set :rig \"'kiosk-1'\"\n"}},
      {"kind", {" --kind moved", ".parameter set :kind \"'moved'\"\n"}},
      {"limit", {" --limit 3", ".parameter set :limit 3\n"}}};
  for (const NamedQuery& query : NamedQueries())
    for (const bool narrowed : {false, true}) {
      std::string flags = "--now 2027-01-15T08:00:00Z --json";
      std::string commands = ".parameter set :now_ns " + std::to_string(now_ns) + "\n";
      for (const std::string& name : query.parameters)
        if (narrowed) {
          flags += spans.at(name).flags;
          commands += spans.at(name).parameters;
        }
      const Outcome theirs = Theirs("-json", commands + query.sql + ";\n");
      const Outcome ours = Ours("query " + query.name + " " + flags);
      ASSERT_EQ(theirs.code, 0) << query.name << ": " << theirs.out;
      ASSERT_EQ(ours.code, 0) << query.name;
      const Json their_rows = theirs.out.empty() ? Json::array() : Json::parse(theirs.out);
      const Json our_rows = Json::parse(ours.out);
      ASSERT_EQ(their_rows.size(), our_rows.size()) << query.name;
      EXPECT_TRUE(narrowed || !our_rows.empty()) << query.name << " answers nothing: the test is empty";
      for (size_t r = 0; r < our_rows.size(); ++r)
        for (const QueryColumn& column : query.columns)
          ExpectEqualCells(their_rows[r].at(column.name), our_rows[r].at(column.name), column,
                           query.name + "." + column.name + " row " + std::to_string(r));
    }
}

// In which the shell calls nothing that reaches beyond the file.
TEST_F(SqliteShell, ViewsWorkInSafeMode) {
  for (const std::string& view : Views()) {
    const Outcome outcome = Theirs("-safe", "SELECT count(*) FROM " + view + ";\n");
    EXPECT_EQ(outcome.code, 0) << view << ": " << outcome.out;
  }
}

}  // namespace
}  // namespace stratalux::db
