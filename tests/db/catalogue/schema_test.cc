// SPDX-License-Identifier: Apache-2.0
// What `.schema` of an index tells a stranger, and that telling it changed nothing else.
#include <algorithm>
#include <fstream>
#include <iterator>
#include <map>

#include <gmock/gmock.h>

#include "db/base/sqlite.h"
#include "shared/capture/session.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

class SchemaTest : public StoreTest {
 protected:
  [[nodiscard]] Connection Index() const {
    return *Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadOnly);
  }
  static std::vector<std::string> Texts(Connection& connection, const std::string& sql) {
    auto select = connection.Prepare(sql);
    EXPECT_TRUE(select.ok()) << select.status().message();
    std::vector<std::string> texts;
    while (*select->Step()) texts.push_back(select->Text(0));
    return texts;
  }
};

struct Definition {
  std::string name, comment;
};

// The columns of a CREATE TABLE with the comment of each: the one before its comma, or behind it on the same line.
class Definitions {
 public:
  explicit Definitions(const std::string& sql) : sql_(sql), at_(sql.find('(') + 1) { Read(); }
  [[nodiscard]] const std::vector<Definition>& columns() const { return columns_; }

 private:
  void Read() {
    int depth = 0;
    bool behind_comma = false;
    std::string text, comment;
    const auto close = [&] {
      const size_t start = text.find_first_not_of(" \n");
      if (start != std::string::npos)
        columns_.push_back({text.substr(start, text.find_first_of(" \n", start) - start), comment});
      text.clear();
      comment.clear();
    };
    while (at_ < sql_.size()) {
      const char c = sql_[at_];
      if (sql_.compare(at_, 2, "--") == 0 || sql_.compare(at_, 2, "/*") == 0) {
        const std::string words = Comment();
        (behind_comma && !columns_.empty() ? columns_.back().comment : comment) += words;
        behind_comma = false;
        continue;
      }
      ++at_;
      if (c == '\'') {
        const size_t end = sql_.find('\'', at_);
        text += sql_.substr(at_ - 1, end + 1 - (at_ - 1));
        at_ = end + 1;
        continue;
      }
      if (c != ' ') behind_comma = false;
      depth += c == '(' ? 1 : c == ')' ? -1 : 0;
      if (depth < 0) break;
      if (c == ',' && depth == 0) {
        close();
        behind_comma = true;
      } else {
        text += c;
      }
    }
    close();
  }
  std::string Comment() {
    const bool line = sql_[at_] == '-';
    const size_t end = std::min(sql_.find(line ? "\n" : "*/", at_), sql_.size());
    std::string words = sql_.substr(at_ + 2, end - at_ - 2);
    at_ = line ? end : end + 2;
    return words;
  }

  const std::string& sql_;
  size_t at_;
  std::vector<Definition> columns_;
};

TEST_F(SchemaTest, EveryColumnOfEveryTableSaysWhatItIs) {
  Connection index = Index();
  const auto tables = Texts(index, "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%'");
  EXPECT_GE(tables.size(), 13U);
  for (const std::string& table : tables) {
    const auto sql = Texts(index, "SELECT sql FROM sqlite_schema WHERE name = '" + table + "'");
    const Definitions definitions(sql[0]);
    std::map<std::string, std::string> comments;
    for (const Definition& d : definitions.columns()) comments[d.name] = d.comment;
    for (const std::string& column : Texts(index, "SELECT name FROM pragma_table_info('" + table + "')")) {
      ASSERT_TRUE(comments.contains(column)) << table << "." << column << " in:\n" << sql[0];
      EXPECT_GT(comments[column].size(), 3U) << table << "." << column << " has no comment in:\n" << sql[0];
    }
  }
}

TEST_F(SchemaTest, TheReaderOfCommentsSeesWhereOneLacks) {
  const std::string sql =
      "CREATE TABLE t (\n  a TEXT CHECK (a IN ('x, y', 'z')), -- of a\n  b INTEGER /* of b */,\n  c BLOB,\n"
      "  d REAL -- of d\n, e INTEGER /* of e */) STRICT";
  const Definitions definitions(sql);
  ASSERT_EQ(definitions.columns().size(), 5U);
  const char* comments[] = {" of a", " of b ", "", " of d", " of e "};
  for (size_t i = 0; i < 5; ++i) EXPECT_EQ(definitions.columns()[i].comment, comments[i]);
}

std::string Migration(const std::string& name) {
  std::ifstream file(std::string(STRATALUX_SOURCE_DIR) + "/db/catalogue/migrations/" + name + ".sql");
  return {std::istreambuf_iterator<char>(file), {}};
}

// Comments are replaced in the text of the schema: were a column, a type or a key lost on the way, rows would be read
// wrongly.
TEST_F(SchemaTest, NewCommentsLeaveColumnsAndKeysOfSchemaFourAsTheyWere) {
  auto old = *Connection::Open(folder_ / "four.sqlite", Connection::Mode::kCreate);
  for (const char* name : {"0001_initial", "0002_people_and_proofs", "0003_views", "0004_calibrations"})
    ASSERT_TRUE(old.Execute(Migration(name)).ok()) << name;
  Connection now = Index();
  const auto columns = [](const std::string& table) {
    return "SELECT name || '|' || type || '|' || \"notnull\" || '|' || coalesce(dflt_value, 'none') || '|' || pk"
           " FROM pragma_table_info('" +
           table + "') ORDER BY cid";
  };
  const auto keys = [](const std::string& table) {
    return "SELECT \"table\" || '|' || \"from\" || '|' || coalesce(\"to\", '') || '|' || on_delete"
           " FROM pragma_foreign_key_list('" +
           table + "') ORDER BY 1";
  };
  for (const std::string table : {"sessions", "calibrations", "frames", "fits", "metrics", "visitors", "consents",
                                  "proofs", "accepted_calibrations"}) {
    const auto before = Texts(old, columns(table)), after = Texts(now, columns(table));
    ASSERT_GE(after.size(), before.size()) << table;
    EXPECT_TRUE(std::equal(before.begin(), before.end(), after.begin())) << table;
    EXPECT_EQ(Texts(old, keys(table)), Texts(now, keys(table))) << table;
  }
  EXPECT_EQ(Texts(now, "PRAGMA integrity_check"), std::vector<std::string>{"ok"});
  EXPECT_THAT(Texts(now, "PRAGMA foreign_key_check"), IsEmpty());
  // The constraints of the text hold: SQLite reads them from it.
  auto writer = *Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
  const Status refused = writer.Execute(
      "INSERT INTO sessions (id, kind, rig, visitor, consent, simulated, seed, started_wall_ns, status, reasons_json,"
      " program_version, plan_json) VALUES ('x', 'visitor', '', '', '', 0, 0, 0, 'great', '[]', '', '')");
  EXPECT_THAT(refused.message(), HasSubstr("CHECK"));
}

TEST_F(SchemaTest, RetentionClassesAreThoseOfThePurge) {
  Connection index = Index();
  const RetentionDays days;
  const std::vector<std::string> expected = {"keep ", "long " + std::to_string(days.long_days),
                                             "short " + std::to_string(days.short_days),
                                             "standard " + std::to_string(days.standard_days)};
  EXPECT_EQ(Texts(index, "SELECT retention || ' ' || coalesce(days, '') FROM retention_classes ORDER BY 1"), expected);
}

// The law of the views: who reads a moment in ns finds it as text beside it.
TEST_F(SchemaTest, EveryMomentOfAViewStandsThereAsTextToo) {
  Connection index = Index();
  for (const std::string& view : Texts(index, "SELECT name FROM sqlite_schema WHERE type = 'view'")) {
    const auto columns = Texts(index, "SELECT name FROM pragma_table_info('" + view + "')");
    for (const std::string& column : columns)
      if (const size_t end = column.rfind("_wall_ns"); end != std::string::npos) {
        EXPECT_THAT(columns, ::testing::Contains(column.substr(0, end))) << view << "." << column;
      }
  }
}

TEST_F(SchemaTest, MomentsAreExactToTheNanosecond) {
  auto writer = *Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
  ASSERT_TRUE(writer
                  .Execute("INSERT INTO access_log (at_wall_ns, who, action, session_id, detail) VALUES"
                           " (1795240447123456789, '', '', '', ''), (999999999, '', '', '', ''), (0, '', '', '', ''),"
                           " (9223372036854775807, '', '', '', '')")
                  .ok());
  EXPECT_EQ(Texts(writer, "SELECT at FROM access_overview ORDER BY number"),
            (std::vector<std::string>{"2026-11-21T05:54:07.123456789Z", "1970-01-01T00:00:00.999999999Z",
                                      "1970-01-01T00:00:00.000000000Z", "2262-04-11T23:47:16.854775807Z"}));
}

TEST_F(SchemaTest, ASessionKnowsTheStepsOfItsPlan) {
  const PlanOptions options;
  SessionInfo info = SimulatedVisit();
  info.plan_json = PlanOptionsToJson(options);
  SessionStore store = OpenStore();
  ASSERT_TRUE(store.BeginSession(info)->Finish(SessionStatus::kFailed).ok());
  StoreSession(1);  // without a plan
  Connection index = Index();
  EXPECT_EQ(Texts(index, "SELECT coalesce(planned_steps, 'none') FROM sessions ORDER BY number"),
            (std::vector<std::string>{std::to_string(BuildPlan(options)->steps.size()), "none"}));
  EXPECT_EQ(Texts(index, "SELECT steps FROM missing_frames"),
            std::vector<std::string>{"0-" + std::to_string(BuildPlan(options)->steps.size() - 1)});
}

TEST_F(SchemaTest, EnumerationsOfFramesAreWords) {
  StoreSession(1);
  Connection index = Index();
  EXPECT_EQ(Texts(index, "SELECT level_check || ' ' || frame_clock FROM frame_overview"),
            std::vector<std::string>{"passed monotonic"});
}

TEST_F(SchemaTest, AJobReadsInWordsAndUtc) {
  StoreSession(1);
  auto writer = *Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
  ASSERT_TRUE(
      writer
          .Execute("INSERT INTO jobs (key, session, kind, state, priority, options_json, created_wall_ns,"
                   " not_before_wall_ns, attempts, max_attempts, owner, fence, boot, until_boot_ns, last_error,"
                   " finished_wall_ns) SELECT 'nightly', number, 'fit', 'set-aside', 5, '{}', 1795240447123456789,"
                   " 1, 3, 3, 'bench:7', 9, 'b', 1, 'lens cap', 999999999 FROM sessions;"
                   "INSERT INTO jobs (key, session, kind, state, priority, options_json, created_wall_ns,"
                   " not_before_wall_ns, attempts, max_attempts, owner, fence, boot, until_boot_ns, last_error)"
                   " VALUES ('of none', NULL, 'fit', 'queued', 0, '{}', 0, 0, 0, 3, '', 0, '', 0, '')")
          .ok());
  const std::string id = Texts(writer, "SELECT id FROM sessions").front();
  EXPECT_EQ(Texts(writer,
                  "SELECT key || '|' || coalesce(session_id, 'none') || '|' || state || '|' ||"
                  " coalesce(owner, 'none') || '|' || coalesce(last_error, 'none') || '|' ||"
                  " coalesce(created, 'none') || '|' || coalesce(not_before, 'none') || '|' ||"
                  " coalesce(finished, 'none') FROM job_overview ORDER BY id"),
            (std::vector<std::string>{"nightly|" + id +
                                          "|set-aside|bench:7|lens cap|2026-11-21T05:54:07.123456789Z|"
                                          "1970-01-01T00:00:00.000000001Z|1970-01-01T00:00:00.999999999Z",
                                      "of none|none|queued|none|none|none|none|none"}));
}

}  // namespace
}  // namespace stratalux::db
