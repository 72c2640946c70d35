// SPDX-License-Identifier: Apache-2.0
// Names from anywhere, such as a rig that is not ours, on a terminal: nothing in them may steer it.
#include <algorithm>
#include <chrono>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/apps/display_text.h"
#include "db/base/sqlite.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using Json = nlohmann::json;

// A colour, a window title, a C1 control as UTF-8, a right-to-left override, a bell, a return, bytes that are no UTF-8.
const std::string kHostile =
    "\x1b[31mred\x1b]0;title\x07\xc2\x9b"
    "2J\xe2\x80\xae"
    "gnp\r\x7f\xff";

bool Steers(const std::string& text) {
  const auto control = [](unsigned char c) { return (c < 0x20 && c != '\n') || c == 0x7f; };
  for (const char* sequence : {"\xc2\x9b", "\xe2\x80\xae", "\xff"})
    if (text.find(sequence) != std::string::npos) return true;
  return std::any_of(text.begin(), text.end(), control);
}

class HostileText : public StoreTest {
 protected:
  [[nodiscard]] Outcome Db(const std::string& arguments) const {
    return Shell("STRATALUX_STORE=" + folder_.string() + " " + STRATALUX_BIN_DIR + "/stratalux-db " + arguments +
                 " 2>&1");
  }
  void Execute(const std::string& sql) const {
    const Status status = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)->Execute(sql);
    ASSERT_TRUE(status.ok()) << status.message();
  }
  static std::string Quoted(const std::string& text) { return "CAST(x'" + Hex(text) + "' AS TEXT)"; }
  static std::string Hex(const std::string& text) {
    std::string hex;
    char pair[3];
    for (const char c : text) {
      std::snprintf(pair, sizeof pair, "%02x", static_cast<unsigned char>(c));
      hex += pair;
    }
    return hex;
  }
};

TEST_F(HostileText, NeverReachesTheTerminal) {
  StoreSession(2);
  const std::string text = Quoted(kHostile);
  Execute("INSERT INTO visitors (id, created_wall_ns) VALUES (" + text + ", 0);" +
          "INSERT INTO consents (visitor, text_version, language, fit, research, publication, given_wall_ns) VALUES (" +
          text + ", " + text + ", " + text + ", 1, 0, 0, 5);" + "UPDATE sessions SET rig = " + text +
          ", visitor = " + text + ", program_version = " + text + ", visit = " + text +
          ", findings_json = json_array(json_object('kind', 'device', 'value', 0, 'limit', 0, 'detail', substr(" +
          text + ", 1, 20))), faults_json = json_object(substr(" + text + ", 1, 20), 3)" +
          ", status = 'failed', reasons_json = json_array(substr(" + text + ", 1, 20)), consent = " + text +
          ", consent_json = '';" + "INSERT INTO access_log (at_wall_ns, who, action, session_id, detail) VALUES (5, " +
          text + ", " + text + ", " + text + ", " + text + ");");
  for (const std::string command : {"ls",
                                    "ls --json",
                                    "show latest",
                                    "show latest --json",
                                    "frames latest",
                                    "consent show",
                                    "consent show --json",
                                    "access",
                                    "access --json",
                                    "query last-night --since 1970-01-01",
                                    "query failures",
                                    "query failures --json",
                                    "query findings",
                                    "query findings --json",
                                    "sql 'SELECT * FROM session_faults'",
                                    "query retention-due",
                                    "query recent-access",
                                    "query rigs",
                                    "query consent-missing",
                                    "sql 'SELECT rig, visitor FROM sessions'",
                                    "sql 'SELECT rig, visitor FROM sessions' --json",
                                    "stats --since 1w",
                                    "verify",
                                    "purge --dry-run",
                                    "deletions"}) {
    const Outcome outcome = Db(command);
    EXPECT_FALSE(Steers(outcome.out)) << command << ":\n" << Printable(outcome.out);
    EXPECT_NE(outcome.code, -1) << command;
    if (command.ends_with("--json")) {
      EXPECT_FALSE(Json::parse(outcome.out, nullptr, false).is_discarded()) << command;
    }
  }
  EXPECT_THAT(Db("show latest").out, HasSubstr("\\x1b[31mred"));
}

TEST_F(HostileText, NorFromWhatIsTypedOrNamed) {
  const std::string program = std::string(STRATALUX_BIN_DIR) + "/stratalux-db ";
  for (const std::string command :
       {"show \"$X\"", "\"$X\"", "consent \"$X\"", "ls --status \"$X\"", "ls --since \"$X\"", "query \"$X\"",
        "sql \"SELECT $X\"", "import --manifest \"$X\"", "init --store \"/proc/$X\"", "ls --store \"$X\"", "ls \"$X\"",
        "restore --from \"$X\"", "forget \"$X\" --yes", "forget --visitor \"$X\" --yes", "key import \"$X\""}) {
    const Outcome outcome =
        Shell("X=$(printf '\\033[31m\\233'); STRATALUX_STORE=" + folder_.string() + " " + program + command + " 2>&1");
    EXPECT_FALSE(Steers(outcome.out)) << command << ":\n" << Printable(outcome.out);
    EXPECT_GT(outcome.code, 0) << command;
  }
}

TEST_F(HostileText, ACertificateOfAnotherShapeIsListedAndNothingMore) {
  std::filesystem::create_directories(folder_ / "deletions");
  const char* kShapes[] = {
      R"({"verification": {"clean": "yes", "markers": [], "files_read": {}}, "deleted": 5, "reason": {}})",
      R"({"verification": [1], "frames": "many"})",
      "[]",
      "7",
      "null",
      "\"text\"",
      "{",
      "",
      R"({"verification": {"clean": true}, "deleted": "\u001b[31m", "frames": 1e300})"};
  int number = 1;
  for (const char* shape : kShapes) {
    char id[40];
    std::snprintf(id, sizeof id, "s%06d-aaaaaaaa", number++);
    WriteText(folder_ / "deletions" / (std::string(id) + ".json"), shape);
    Execute("INSERT OR REPLACE INTO deletions (session_id, deleted_wall_ns, reason, certificate_json) VALUES ('" +
            std::string(id) + "', 5, 'forget', '" + shape + "')");
  }
  for (const char* command : {"deletions", "deletions --json", "show s000001"}) {
    const Outcome outcome = Db(command);
    EXPECT_EQ(outcome.signal, 0) << command;
    EXPECT_TRUE(outcome.code == 0 || outcome.code == 4) << command << " " << outcome.code << outcome.out;
    EXPECT_FALSE(Steers(outcome.out)) << command;
  }
  EXPECT_THAT(Db("deletions").out, HasSubstr("s000001-aaaaaaaa"));
}

TEST_F(HostileText, SqlEndsInTimeWhateverItsFunctionsDo) {
  // One call that compares the halves of long texts, far longer than its second.
  const std::string slow =
      "sql --seconds 1 \"SELECT instr(hex(zeroblob(7000000)), substr(hex(zeroblob(3500000)), 2) || '1')\"";
  const auto start = std::chrono::steady_clock::now();
  const Outcome outcome = Db(slow);
  EXPECT_EQ(outcome.code, 1) << outcome.out;
  EXPECT_THAT(outcome.out, HasSubstr("stopped after 1000 ms"));
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(8));
  EXPECT_EQ(
      Shell("STRATALUX_STORE=" + folder_.string() + " " + STRATALUX_BIN_DIR + "/stratalux-db sql - < /dev/zero 2>&1")
          .code,
      2)
      << "a statement without an end";
  EXPECT_EQ(Db("sql 'SELECT zeroblob(1000000000)'").code, 2);
}

TEST_F(HostileText, OneLongTextDoesNotWidenEveryRow) {
  const Outcome outcome =
      Db("sql \"SELECT hex(zeroblob(500000)) AS a, 1 AS b UNION ALL SELECT 'x', value FROM json_each('[1,2,3]')\"");
  EXPECT_EQ(outcome.code, 0);
  EXPECT_LT(outcome.out.size(), 1'010'000U);
}

TEST_F(HostileText, ConsentHasOneShape) {
  const std::string with = StoreSession(1), without = StoreSession(1);
  Execute(
      "INSERT INTO visitors (id, created_wall_ns) VALUES ('v', 0);"
      "INSERT INTO consents (visitor, text_version, language, fit, research, publication, given_wall_ns,"
      " withdrawn_wall_ns) VALUES ('v', '3', 'de', 1, 0, 0, 5, 1700000000000000001);"
      "UPDATE sessions SET visitor = 'v', consent = '3', consent_json ="
      " '{\"text_version\":\"3\",\"language\":\"de\",\"scope\":[\"fit\"],\"given_wall_ns\":5}' WHERE id = '" +
      with + "'; UPDATE sessions SET consent = '', consent_json = '' WHERE id = '" + without + "'");
  const Json list = Json::parse(Db("ls --json --sort session").out);
  const Json shown = Json::parse(Db("show --json " + with).out), none = Json::parse(Db("show --json " + without).out);
  ASSERT_EQ(list.size(), 2U);
  EXPECT_EQ(list[0]["consent"], shown["consent"]);
  EXPECT_EQ(shown["consent"], Json({{"text_version", "3"},
                                    {"language", "de"},
                                    {"scope", {"fit"}},
                                    {"given_wall_ns", 5},
                                    {"withdrawn", "2023-11-14T22:13:20.000000001Z"}}));
  EXPECT_TRUE(list[1]["consent"].is_null());
  EXPECT_TRUE(none["consent"].is_null());
  // Of schema 1: a version of a text and no more.
  Execute("UPDATE sessions SET consent = 'text 1', consent_json = '' WHERE id = '" + without + "'");
  const Json old = Json::parse(Db("show --json " + without).out)["consent"];
  EXPECT_EQ(old["text_version"], "text 1");
  EXPECT_EQ(old.size(), shown["consent"].size());
  EXPECT_EQ(Json::parse(Db("ls --json --sort session").out)[1]["consent"], old);
  EXPECT_THAT(Db("show " + with).out, HasSubstr("text 3 (de): fit; WITHDRAWN 2023-11-14T22:13:20"));
  EXPECT_THAT(Db("show " + with).out, HasSubstr("purge"));
}

TEST_F(HostileText, AForgottenSessionIsCalledSo) {
  const std::string id = StoreSession(1);
  ASSERT_EQ(Db("forget " + id + " --yes").code, 0);
  const Outcome outcome = Db("show " + id);
  EXPECT_EQ(outcome.code, 4);
  EXPECT_THAT(outcome.out, HasSubstr("session " + id + " was forgotten"));
  EXPECT_THAT(Db("show s999999").out, Not(HasSubstr("forgotten")));
}

TEST_F(HostileText, LongReasonsAreWrapped) {
  StoreSession(1);
  std::string reason;
  for (int i = 0; i < 60; ++i) reason += "word" + std::to_string(i) + " ";
  Execute("UPDATE sessions SET status = 'degraded', reasons_json = json_array('" + reason + "')");
  std::istringstream lines(Db("show latest").out);
  size_t longest = 0;
  int parts = 0;
  for (std::string line; std::getline(lines, line);) {
    longest = std::max(longest, line.size());
    parts += line.find("word") != std::string::npos ? 1 : 0;
  }
  EXPECT_LE(longest, 100U);
  EXPECT_GE(parts, 5);
}

TEST_F(HostileText, InitTakesNoFolderOfOthers) {
  const auto init = [this](const std::string& name) { return Db("init --store " + (folder_ / name).string()); };
  for (const char* name : {"empty", "mounted/lost+found", "mounted/.Trash-1000", "home/.ssh", "photos/summer"})
    std::filesystem::create_directories(folder_ / name);
  EXPECT_EQ(init("empty").code, 0);
  EXPECT_EQ(init("empty").code, 0) << "a store stays one";
  EXPECT_EQ(init("mounted").code, 0);
  for (const char* name : {"home", "photos"}) {
    const Outcome outcome = init(name);
    EXPECT_EQ(outcome.code, 2) << name;
    EXPECT_THAT(outcome.out, HasSubstr("holds other things"));
    EXPECT_THAT(outcome.out, HasSubstr("init --store"));
    EXPECT_FALSE(std::filesystem::exists(folder_ / name / "index.sqlite"));
  }
  WriteText(folder_ / "file", "x");
  EXPECT_NE(init("file").code, 0);
}

TEST(WrappedText, BreaksAtBlanksAndKeepsEveryWord) {
  EXPECT_EQ(Wrapped("one two three", 7, "  "), "one two\n  three");
  EXPECT_EQ(Wrapped("incomprehensibilities a", 5, ""), "incomprehensibilities\na");
  EXPECT_EQ(Wrapped("", 5, ""), "");
  EXPECT_EQ(Wrapped("a  b", 10, ""), "a  b");
}

}  // namespace
}  // namespace stratalux::db
