// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/named_query.h"

#include <algorithm>
#include <fstream>
#include <iterator>
#include <map>
#include <regex>
#include <set>

#include <gmock/gmock.h>

#include "db/base/sqlite.h"
#include "db/catalogue/session_filter.h"
#include "tests/db/index_rows.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

constexpr int64_t kDay_ns = int64_t{86400} * 1'000'000'000;
constexpr int64_t kNow_ns = 20'000 * kDay_ns + kDay_ns / 3;  // 08:00 UTC
using Row = std::vector<Cell>;

std::string operator""_s(const char* text, size_t size) { return {text, size}; }

class NamedQueryTest : public StoreTest {
 protected:
  ResultTable Answer(const std::string& name, QueryParameters parameters = {}) {
    auto index = ReadOnlyIndex::Open(folder_);
    const auto query = FindQuery(name);
    EXPECT_TRUE(index.ok() && query.ok()) << name;
    parameters.emplace("now_ns", kNow_ns);
    auto table = RunQuery(*index, **query, parameters);
    EXPECT_TRUE(table.ok()) << table.status().message();
    return table.ok() ? *table : ResultTable();
  }
  std::vector<Row> Rows(const std::string& name, const QueryParameters& parameters = {}) {
    return Answer(name, parameters).rows;
  }
  void Execute(const std::string& sql) const {
    auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
    // Nobody pulls the plug on a test.
    const Status status = connection->Execute("PRAGMA synchronous = OFF; BEGIN; " + sql + "; COMMIT");
    ASSERT_TRUE(status.ok()) << sql << ": " << status.message();
  }
  struct Session {
    int number;
    int64_t started_ns;
    std::string rig = "a", status = "complete", kind = "visitor", reasons = "[]";
    std::string visitor = {}, consent = {}, retention = "standard";
  };
  void Insert(const Session& s) const {
    const auto quoted = [](const std::string& text) { return "'" + text + "'"; };
    Execute(
        "INSERT INTO sessions (number, id, kind, rig, visitor, consent, simulated, seed, started_wall_ns, status,"
        " reasons_json, program_version, plan_json, consent_json, retention) VALUES (" +
        std::to_string(s.number) + ", 's" + std::to_string(s.number) + "', " + quoted(s.kind) + ", " + quoted(s.rig) +
        ", " + quoted(s.visitor) + ", '', 0, 0, " + std::to_string(s.started_ns) + ", " + quoted(s.status) + ", " +
        quoted(s.reasons) + ", '', '', " + quoted(s.consent) + ", " + quoted(s.retention) + ")");
  }
  static std::vector<std::string> Texts(const std::vector<Row>& rows, size_t column) {
    std::vector<std::string> texts;
    for (const Row& row : rows) texts.push_back(std::get<std::string>(row[column]));
    return texts;
  }
};

TEST_F(NamedQueryTest, EachSaysWhatItAnswersAndGivesThoseColumns) {
  EXPECT_GE(NamedQueries().size(), 12U);
  for (const NamedQuery& query : NamedQueries()) {
    const auto parsed = ParseQuery(query.name, query.sql);
    ASSERT_TRUE(parsed.ok()) << parsed.status().message();
    EXPECT_TRUE(parsed->question.ends_with("?")) << query.name;
    const ResultTable table = Answer(query.name);  // fails where head and columns part
    EXPECT_EQ(table.columns.size(), query.columns.size()) << query.name;
    EXPECT_THAT(table.rows, IsEmpty()) << query.name << " on an empty store";
  }
  EXPECT_EQ(FindQuery("nothing").status().code(), StatusCode::kNotFound);
}

TEST_F(NamedQueryTest, EachTakesTheParametersItNamesAndNoOther) {
  const std::map<std::string, std::string> placeholders = {
      {"since", ":since_ns"}, {"until", ":until_ns"}, {"rig", ":rig"}, {"kind", ":kind"}, {"limit", ":limit"}};
  for (const NamedQuery& query : NamedQueries()) {
    const std::set<std::string> named(query.parameters.begin(), query.parameters.end());
    for (const auto& [name, placeholder] : placeholders)
      EXPECT_EQ(named.contains(name), query.sql.find(placeholder) != std::string::npos) << query.name << " --" << name;
  }
}

TEST_F(NamedQueryTest, EachIsDocumented) {
  std::ifstream file(std::string(STRATALUX_SOURCE_DIR) + "/docs/store-queries.md");
  const std::string page((std::istreambuf_iterator<char>(file)), {});
  for (const NamedQuery& query : NamedQueries()) {
    const size_t start = page.find("### " + query.name + "\n");
    ASSERT_NE(start, std::string::npos) << query.name;
    const std::string section = page.substr(start, page.find("\n### ", start) - start);
    EXPECT_NE(section.find(query.question), std::string::npos) << query.name;
    for (const QueryColumn& column : query.columns)
      EXPECT_NE(section.find("| `" + column.name + "` | " + column.kind + " | " + column.meaning + " |"),
                std::string::npos)
          << query.name << "." << column.name;
    for (const std::string& parameter : query.parameters)
      EXPECT_NE(section.find("`--" + parameter + "`"), std::string::npos) << query.name << " --" << parameter;
  }
}

// Tables that hold a row a frame, under whatever name `sql` uses them, that the plan reads from end to end.
std::vector<std::string> FullScans(ReadOnlyIndex& index, const std::string& sql) {
  std::string aliases = "frames|proofs";
  const std::regex use(R"((FROM|JOIN|,)\s+(frames|proofs|frame_overview)\s+(AS\s+)?([a-z]\w*))");
  for (std::sregex_iterator i(sql.begin(), sql.end(), use), end; i != end; ++i) aliases += "|" + (*i)[4].str();
  const std::regex scan("^SCAN (" + aliases + ")\\b.*");
  const auto plan = index.Run("EXPLAIN QUERY PLAN " + sql);
  EXPECT_TRUE(plan.ok()) << plan.status().message();
  std::vector<std::string> scans;
  for (const Row& row : plan->rows)
    if (const auto& detail = std::get<std::string>(row[3]); std::regex_match(detail, scan)) scans.push_back(detail);
  return scans;
}

// In the order of the partial index: a limit ends the work.
TEST_F(NamedQueryTest, MissingFramesReadsIncompleteSessionsAloneNewestFirst) {
  auto index = *ReadOnlyIndex::Open(folder_);
  const auto query = std::find_if(NamedQueries().begin(), NamedQueries().end(),
                                  [](const auto& q) { return q.name == "missing-frames"; });
  ASSERT_NE(query, NamedQueries().end());
  const auto plan = index.Run("EXPLAIN QUERY PLAN " + query->sql);
  ASSERT_TRUE(plan.ok()) << plan.status().message();
  ASSERT_FALSE(plan->rows.empty());
  EXPECT_EQ(std::get<std::string>(plan->rows[0][3]), "SCAN s USING INDEX sessions_incomplete");
  for (const Row& row : plan->rows)
    EXPECT_EQ(std::get<std::string>(row[3]).find("TEMP B-TREE FOR ORDER BY"), std::string::npos);
}

TEST_F(NamedQueryTest, NoneReadsAllFrames) {
  auto index = *ReadOnlyIndex::Open(folder_);
  for (const NamedQuery& query : NamedQueries()) EXPECT_THAT(FullScans(index, query.sql), IsEmpty()) << query.name;
  SessionFilter filter;
  filter.calibration = "ab";
  filter.bounds = {{"nrmse", FitBound::Side::kAtMost, 0.5}};
  EXPECT_THAT(FullScans(index, QueryOf(filter).sql), IsEmpty());
  // The law sees what it forbids.
  EXPECT_EQ(FullScans(index, "SELECT count(*) FROM frames f WHERE f.stored_bytes > 7").size(), 1U);
  EXPECT_EQ(FullScans(index, "SELECT 1 FROM sessions s JOIN proofs p WHERE p.mean_dn > s.number").size(), 1U);
}

TEST_F(NamedQueryTest, AgreeWithCountingTheRowsByHand) {
  std::filesystem::remove_all(folder_);
  std::filesystem::create_directory(folder_);
  IndexRowsOptions options{.sessions = 60, .frames_per_session = 80, .seed = 3, .now = {kNow_ns}};
  const auto sessions = WriteIndexRows(folder_, options);
  std::map<std::pair<std::string, std::string>, int64_t> retakes;
  std::map<std::string, int64_t> bytes_of_rig, per_day;
  std::vector<std::string> unfitted;
  std::map<std::string, int64_t> missing;
  for (const RowsOfSession& s : sessions) {
    for (const std::string& cause : s.retake_causes) ++retakes[{s.row.info.rig, cause}];
    bytes_of_rig[s.row.info.rig] += s.row.bytes;
    ++per_day[ToIso8601(s.row.info.started_wall).substr(0, 10)];
    const bool whole = s.row.info.status == SessionStatus::kComplete || s.row.info.status == SessionStatus::kDegraded;
    if (whole && s.row.info.kind == SessionKind::kVisitor && s.fits.empty()) unfitted.push_back(s.row.info.id);
    if (s.row.info.status != SessionStatus::kComplete)
      missing[s.row.info.id] = PlannedStepsOfRows() - static_cast<int64_t>(s.good_steps.size());
  }
  ASSERT_GT(retakes.size(), 5U);
  ASSERT_GT(missing.size(), 2U);
  for (const Row& row : Rows("retakes")) {
    const std::pair key(std::get<std::string>(row[0]), std::get<std::string>(row[1]));
    EXPECT_EQ(std::get<int64_t>(row[2]), retakes[key]);
    retakes.erase(key);
  }
  EXPECT_THAT(retakes, IsEmpty());
  for (const Row& row : Rows("disk-use")) bytes_of_rig[std::get<std::string>(row[0])] -= std::get<int64_t>(row[5]);
  for (const auto& [rig, rest] : bytes_of_rig) EXPECT_EQ(rest, 0) << rig;
  for (const Row& row : Rows("sessions-per-day")) per_day[std::get<std::string>(row[0])] -= std::get<int64_t>(row[1]);
  for (const auto& [day, rest] : per_day) EXPECT_EQ(rest, 0) << day;
  EXPECT_EQ(Texts(Rows("oldest-unfitted"), 0), unfitted);
  EXPECT_EQ(Texts(Rows("oldest-unfitted", {{"limit", int64_t{2}}}), 0),
            std::vector<std::string>(unfitted.begin(), unfitted.begin() + 2));
  for (const Row& row : Rows("missing-frames")) {
    EXPECT_EQ(std::get<int64_t>(row[6]), missing[std::get<std::string>(row[0])]);
    missing.erase(std::get<std::string>(row[0]));
  }
  EXPECT_THAT(missing, IsEmpty());
}

TEST_F(NamedQueryTest, MissingFramesNamesTheSteps) {
  PlanOptions options;
  const auto planned = static_cast<int>(BuildPlan(options)->steps.size());
  Insert({1, kNow_ns, "a", "degraded"});
  Insert({2, kNow_ns, "a", "failed"});
  Insert({3, kNow_ns, "a", "complete"});
  Execute("UPDATE sessions SET plan_json = '" + PlanOptionsToJson(options) +
          "', planned_steps = " + std::to_string(planned));
  std::string inserts;
  for (int step = 0, frame = 0; step < planned; ++step) {
    const bool absent = step == 0 || (step >= 10 && step <= 12);
    const int check = step == 20 ? 2 : step == 21 ? 0 : 1;  // 20 failed its check, 21 was not checked
    if (!absent)
      inserts +=
          ("INSERT INTO frames (session, frame, segment, offset, stored_bytes, hash, step, projector, phase,"
           " pattern, retry, level_check) VALUES (1, " +
           std::to_string(frame++) + ", 1, 64, 1, x'', " + std::to_string(step) + ", 0, 'sweep', 'white', 0, " +
           std::to_string(check) + ");");
  }
  Execute(inserts);
  const auto rows = Rows("missing-frames");
  ASSERT_EQ(rows.size(), 2U) << "the complete session is not asked";
  EXPECT_EQ(rows[0][0], Cell("s2"_s)) << "newest first";
  EXPECT_EQ(rows[0][7], Cell("0-" + std::to_string(planned - 1)));
  EXPECT_THAT(Row(rows[1].begin() + 4, rows[1].end()), ElementsAre(Cell(int64_t{planned}), Cell(int64_t{planned - 5}),
                                                                   Cell(int64_t{5}), Cell("0, 10-12, 20"_s)));
}

TEST_F(NamedQueryTest, LastNightLastsFromNoonToNoonLocalTime) {
  setenv("TZ", "UTC", 1);
  tzset();
  const int64_t noon_ns = 20'000 * kDay_ns - kDay_ns / 2;
  Insert({1, noon_ns - 1});
  Insert({2, noon_ns});
  Insert({3, kNow_ns - 1});
  Insert({4, noon_ns + kDay_ns - 1});
  Insert({5, noon_ns + kDay_ns});
  EXPECT_THAT(Texts(Rows("last-night"), 0), ElementsAre("s4", "s3", "s2"));
  EXPECT_THAT(Texts(Rows("last-night", {{"since_ns", noon_ns + kDay_ns}}), 0), ElementsAre("s5"));
  setenv("TZ", "JST-9", 1);  // noon in Tokyo is 03:00 UTC
  tzset();
  EXPECT_THAT(Texts(Rows("last-night"), 0), ElementsAre("s2", "s1")) << "17:00 there: the night ended five hours ago";
  unsetenv("TZ");
  tzset();
}

TEST_F(NamedQueryTest, FailuresCountsEqualReasonsTogether) {
  Insert({1, 10, "a", "degraded", "visitor", R"(["no proven frame for step 3", "lamp"])"});
  Insert({2, 20, "b", "degraded", "visitor", R"(["no proven frame for step 417"])"});
  Insert({3, 30, "a", "failed", "visitor", R"(["lamp"])"});
  Insert({4, 40, "a", "failed", "visitor", "not json"});
  Insert({5, 50, "a", "complete", "visitor", R"(["lamp"])"});
  const auto rows = Rows("failures");
  ASSERT_EQ(rows.size(), 4U);
  EXPECT_THAT(rows[0], ElementsAre(Cell("degraded"_s), Cell("no proven frame for step N"_s), Cell(int64_t{2}),
                                   Cell(int64_t{2}), Cell(int64_t{20}), Cell("s2"_s)));
  EXPECT_THAT(Texts(rows, 1), ElementsAre("no proven frame for step N", "lamp", "(no reason kept)", "lamp"));
}

TEST_F(NamedQueryTest, FindingsAreListedNewestSessionFirstInTheOrderOfTheCapture) {
  for (int i = 1; i <= 4; ++i) Insert({i, 10 * i, i == 3 ? "b" : "a", "degraded"});
  Execute("UPDATE sessions SET visit = 'evening', attempt = number, findings_json = '" +
          FindingsToJson(SomeFindings().findings) +
          "' WHERE number IN (1, 3); UPDATE sessions SET findings_json ="
          " '[7, \"x\", {\"kind\": \"lamp\", \"value\": 0.5, \"limit\": 0.1}]' WHERE number = 2;"
          "UPDATE sessions SET findings_json = 'no json' WHERE number = 4");
  const auto rows = Rows("findings");
  EXPECT_THAT(Texts(rows, 0), ElementsAre("s3", "s3", "s2", "s1", "s1"));
  EXPECT_THAT(Texts(rows, 6), ElementsAre("moved", "device", "lamp", "moved", "device"));
  EXPECT_THAT(rows[0], ElementsAre(Cell("s3"_s), Cell(int64_t{30}), Cell("b"_s), Cell("evening"_s), Cell(int64_t{3}),
                                   Cell("degraded"_s), Cell("moved"_s), Cell(int64_t{2}), Cell(int64_t{117}),
                                   Cell(0.0625), Cell(0.03), Cell()));
  EXPECT_EQ(rows[1][11], Cell("/dev/video0: \"gone\""_s));
  EXPECT_THAT(Texts(Rows("findings", {{"kind", "moved"_s}}), 0), ElementsAre("s3", "s1"));
  EXPECT_THAT(Texts(Rows("findings", {{"rig", "b"_s}, {"limit", int64_t{1}}}), 0), ElementsAre("s3"));
  EXPECT_THAT(Texts(Rows("findings", {{"until_ns", int64_t{20}}}), 0), ElementsAre("s1", "s1"));
}

// Nine sessions in ten have none.
TEST_F(NamedQueryTest, FindingsReadsSessionsWithFindingsAlone) {
  auto index = *ReadOnlyIndex::Open(folder_);
  const auto plan_of = [&index](const std::string& sql) {
    const auto plan = index.Run("EXPLAIN QUERY PLAN " + sql);
    EXPECT_TRUE(plan.ok()) << plan.status().message();
    return plan.ok() && !plan->rows.empty() ? std::get<std::string>(plan->rows[0][3]) : "";
  };
  EXPECT_EQ(plan_of((*FindQuery("findings"))->sql), "SCAN s USING INDEX sessions_found");
  EXPECT_EQ(plan_of("SELECT * FROM session_faults ORDER BY session DESC"), "SCAN s USING INDEX sessions_faulty");
  EXPECT_EQ(plan_of("SELECT id FROM sessions WHERE visit = 'evening' ORDER BY attempt"),
            "SEARCH sessions USING INDEX sessions_by_visit (visit=?)");
}

TEST_F(NamedQueryTest, ConsentMissingAndRetentionDueFollowTheConsentOfTheSession) {
  Execute("INSERT INTO visitors VALUES ('v1', 0), ('v2', 0)");
  Execute(
      "INSERT INTO consents VALUES (1, 'v1', '3', 'de', 1, 0, 0, 100, 777), (2, 'v1', '3', 'de', 1, 0, 0, 200, NULL),"
      " (3, 'v2', '3', 'de', 1, 0, 0, 100, NULL)");
  const auto consent = [](int given, const std::string& scope) {
    return R"({"text_version":"3","language":"de","scope":[)" + scope + R"(],"given_wall_ns":)" +
           std::to_string(given) + "}";
  };
  Insert({1, kNow_ns - 31 * kDay_ns, "a", "complete", "visitor", "[]", "v1", consent(100, "\"fit\""), "long"});
  Insert({2, kNow_ns - 31 * kDay_ns, "a", "complete", "visitor", "[]", "v1", consent(200, "\"fit\""), "short"});
  Insert({3, kNow_ns - 29 * kDay_ns, "a", "complete", "visitor", "[]", "v2", "", "short"});
  Insert({4, kNow_ns - 9000 * kDay_ns, "a", "complete", "visitor", "[]", "v2", consent(100, "\"research\""), "keep"});
  Insert({5, kNow_ns - 9000 * kDay_ns, "a", "complete", "calibration", "[]", "", "", "short"});
  Execute("INSERT INTO fits VALUES ('f', 4, '', '', 0)");
  const auto missing = Rows("consent-missing");
  EXPECT_THAT(Texts(missing, 0), ElementsAre("s4", "s3", "s1"));
  EXPECT_THAT(Texts(missing, 4), ElementsAre("fitted without that scope", "none kept", "withdrawn"));
  const auto due = Rows("retention-due");
  EXPECT_THAT(Texts(due, 0), ElementsAre("s1", "s2"));
  EXPECT_THAT(Texts(due, 4), ElementsAre("consent withdrawn", "short"));
  EXPECT_DOUBLE_EQ(std::get<double>(due[1][6]), 1.0) << "31 days old, kept for 30";
}

TEST_F(NamedQueryTest, FitQualityIsTheMeanOfTheDay) {
  const std::string session = StoreSession(1);
  auto store = OpenStore();
  const auto fit = [&](const std::string& id, double nrmse, int64_t created_ns) {
    const std::string json =
        R"({"prediction": [{"light": "stripe", "model": "tied", "part": "total", "direct": "separated",)"
        R"("geometry": "reconstructed", "nrmse": )" +
        std::to_string(nrmse) + "}]}";
    ASSERT_TRUE(store.RegisterFit({id, session, "{}", json, {created_ns}}).ok());
  };
  fit("a", 0.5, kDay_ns);
  fit("b", 0.25, kDay_ns + 5);
  fit("c", 0.75, 2 * kDay_ns);
  fit("c", 0.125, 2 * kDay_ns);  // replaces itself, its figures too
  const auto rows = Rows("fit-quality");
  ASSERT_EQ(rows.size(), 2U);
  EXPECT_THAT(rows[0], ElementsAre(Cell("1970-01-03"_s), Cell(int64_t{1}), Cell(0.125), Cell(0.125), Cell(0.125),
                                   Cell(), Cell()));
  EXPECT_THAT(rows[1],
              ElementsAre(Cell("1970-01-02"_s), Cell(int64_t{2}), Cell(0.375), Cell(0.25), Cell(0.5), Cell(), Cell()));
}

}  // namespace
}  // namespace stratalux::db
