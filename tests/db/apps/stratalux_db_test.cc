// SPDX-License-Identifier: Apache-2.0
// The command line: what it prints and how it exits.
#include <algorithm>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "shared/image/png.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;

class StrataluxDb : public StoreTest {
 protected:
  [[nodiscard]] Outcome Db(const std::string& arguments, const std::string& redirect = "2>/dev/null") const {
    return Shell("STRATALUX_STORE=" + folder_.string() + " " + STRATALUX_BIN_DIR + "/stratalux-db " + arguments + " " +
                 redirect);
  }
  [[nodiscard]] nlohmann::json Json(const std::string& arguments) const {
    return nlohmann::json::parse(Db(arguments + " --json").out, nullptr, false);
  }
};

TEST_F(StrataluxDb, ListsAndShowsSessions) {
  const std::string first = StoreSession(1), second = StoreSession(3);
  ASSERT_TRUE(OpenStore().RegisterFit({"f1", second, "{}", R"({"rms": 0.25})", {5}}).ok());
  const auto list = Json("ls");
  ASSERT_EQ(list.size(), 2U);
  EXPECT_EQ(list[0]["session"], second);
  EXPECT_EQ(list[0]["frames"], 3);
  EXPECT_EQ(list[0]["bytes"], 3 * 36);
  EXPECT_EQ(list[0]["fits"], 1);
  EXPECT_EQ(list[1]["fits"], 0);
  EXPECT_THAT(Db("ls").out, HasSubstr(first));
  const auto show = Json("show latest");
  EXPECT_EQ(show["session"], second);
  EXPECT_EQ(show["status"], "complete");
  EXPECT_EQ(show["fits"][0]["metrics"]["rms"], 0.25);
  EXPECT_THAT(Db("show s000001").out, HasSubstr(first));
}

TEST_F(StrataluxDb, ShowsVisitAndFindingsAsWordsAndAsNumbers) {
  StoreSession(1);
  std::string id;
  {
    SessionStore store = OpenStore();
    SessionInfo info = SimulatedVisit();
    info.visit = "evening";
    info.attempt = 2;
    auto writer = store.BeginSession(info);
    ASSERT_TRUE(AppendTo(*writer, 0).ok());
    // A reason that is a finding's own words is said once.
    const std::string reason = ToText(SomeFindings().findings)[1];
    ASSERT_TRUE(writer->Finish(SessionStatus::kDegraded, {reason}, SomeFindings()).ok());
    id = writer->info().id;
  }
  const std::string text = Db("show latest").out;
  EXPECT_THAT(text, HasSubstr("visit             evening, attempt 2\n"));
  EXPECT_THAT(text,
              HasSubstr("  reason          /dev/video0: \"gone\"\n  finding         projector 2: step 117: differs by"
                        " 6.2 %"));
  EXPECT_EQ(text.find("gone"), text.rfind("gone"));
  EXPECT_THAT(text, HasSubstr("spoilt shots      lost frame 2, wrong level 14\n"));
  const auto show = Json("show latest");
  EXPECT_EQ(show["visit"], "evening");
  EXPECT_EQ(show["attempt"], 2);
  EXPECT_EQ(show["findings"], nlohmann::json::parse(FindingsToJson(SomeFindings().findings)));
  EXPECT_EQ(show["faults"], nlohmann::json::parse(FaultsToJson(SomeFindings().faults)));
  EXPECT_EQ(Json("show s000001")["findings"], nlohmann::json::array());
  const auto listed = Json("ls --visit evening");
  ASSERT_EQ(listed.size(), 1U);
  EXPECT_EQ(listed[0]["session"], id);
  EXPECT_EQ(listed[0]["attempt"], 2);
  EXPECT_EQ(Json("ls --visit morning").size(), 0U);
  const auto moved = Json("query findings --kind moved");
  ASSERT_EQ(moved.size(), 1U);
  EXPECT_EQ(moved[0]["step"], 117);
  EXPECT_EQ(moved[0]["limit"], 0.03);
  EXPECT_EQ(Db("query findings --kind mvoed").code, 2);
  EXPECT_THAT(Db("query findings --kind mvoed", "2>&1").out, HasSubstr("did you mean 'moved'"));
  EXPECT_EQ(Db("query failures --kind moved").code, 2) << "a flag the query does not know";
}

TEST_F(StrataluxDb, FiltersAndExtractsFrames) {
  StoreSession(6);
  const auto frames = Json("frames latest --projector 1 --phase correspondence");
  ASSERT_EQ(frames.size(), 2U);
  EXPECT_EQ(frames[0]["step"], 1);
  EXPECT_EQ(frames[1]["step"], 5);
  EXPECT_EQ(frames[0]["pattern"], "gray rows bit=3/10 inverse");
  EXPECT_EQ(Json("frames latest --phase sweep").size(), 0U);
  ASSERT_EQ(Db("frames latest --projector 1 --extract " + (folder_ / "out").string()).code, 0);
  int bits = 0;
  const auto image = ReadPng(folder_ / "out" / "000005-gray-rows-bit-3-10-inverse.png", &bits);
  ASSERT_TRUE(image.ok()) << image.status().message();
  EXPECT_EQ(bits, 16);
  const auto expected = PixelsFor(RecordFor(5, PixelFormat::kMono12, 6, 4));
  for (size_t i = 0; i < expected.size(); ++i) EXPECT_EQ(image->data()[i], expected.data()[i] << 4);
}

TEST_F(StrataluxDb, VerifyExitsWith6AndNamesTheOffset) {
  const std::string id = StoreSession(2), other = StoreSession(1);
  EXPECT_EQ(Db("verify").code, 0);
  auto bytes = ReadBytes(Segment(id));
  bytes[64 + 320 + 36 + 320 + 5] ^= 4U;  // payload of the second frame
  WriteBytes(Segment(id), bytes);
  const Outcome all = Db("verify --deep");
  EXPECT_EQ(all.code, 6);
  EXPECT_THAT(all.out, HasSubstr("offset 420"));
  EXPECT_EQ(Db("verify --deep " + other).code, 0);
  EXPECT_EQ(Json("verify --deep " + id)[0]["problems"].size(), 1U);
}

TEST_F(StrataluxDb, InitMakesAStore) {
  const std::string store = (folder_ / "new" / "store").string();
  EXPECT_EQ(Db("ls --store " + store).code, 4);
  EXPECT_EQ(Db("init --store " + store).code, 0);
  EXPECT_EQ(Db("ls --json --store " + store).out, "[]\n");
}

TEST_F(StrataluxDb, ExitsWithTheDocumentedCodes) {
  StoreSession(1);
  StoreSession(1);
  EXPECT_EQ(Db("--version").code, 0);
  EXPECT_THAT(Db("ls --help").out, HasSubstr("Examples:"));
  EXPECT_EQ(Db("").code, 2);
  EXPECT_EQ(Db("frobnicate").code, 2);
  EXPECT_EQ(Db("show").code, 2);
  EXPECT_EQ(Db("show s00000").code, 2);
  EXPECT_EQ(Db("show nobody").code, 4);
  EXPECT_EQ(Db("frames latest --phase party").code, 2);
  EXPECT_EQ(Db("import --manifest " + (folder_ / "none.toml").string()).code, 2);
  EXPECT_EQ(Shell("env -u STRATALUX_STORE " + std::string(STRATALUX_BIN_DIR) + "/stratalux-db ls 2>/dev/null").code, 2);
}

TEST_F(StrataluxDb, ListsWhatPassesTheFilters) {
  const std::string plain = StoreSession(1), fitted = StoreSession(2);
  ASSERT_TRUE(OpenStore().RegisterFit({"f", fitted, "{}", R"({"fit": {"divergence": 0.5}})", {5}}).ok());
  const auto ids = [this](const std::string& flags) {
    std::vector<std::string> found;
    for (const auto& session : Json("ls " + flags)) found.push_back(session["session"]);
    return found;
  };
  using ::testing::ElementsAre;
  EXPECT_THAT(ids("--sort session"), ElementsAre(plain, fitted));
  EXPECT_THAT(ids("--fitted no"), ElementsAre(plain));
  EXPECT_THAT(ids("--max-error divergence=0.5 --status complete,degraded --rig bench --rig other"),
              ElementsAre(fitted));
  EXPECT_THAT(ids("--max-error fit.divergence=0.4"), ElementsAre());
  EXPECT_THAT(ids("--until 1h"), ElementsAre(fitted, plain)) << "the fixture's sessions start in 1970";
  EXPECT_THAT(ids("--since 1h"), ElementsAre());
  EXPECT_THAT(ids("--calibration none --limit 1"), ElementsAre(fitted));
  EXPECT_THAT(Db("ls --csv").out, ::testing::StartsWith("session,started,kind,"));
  for (const char* wrong : {"--since yesterday-ish", "--status great", "--kind party", "--fitted maybe",
                            "--sort colour", "--max-error x=y", "--limit -1", "--json --csv"})
    EXPECT_EQ(Db("ls " + std::string(wrong)).code, 2) << wrong;
}

TEST_F(StrataluxDb, AnswersByNameAndBySql) {
  StoreSession(3);
  EXPECT_THAT(Db("query --list").out, HasSubstr("missing-frames"));
  EXPECT_EQ(Json("query disk-use")[0]["frames"], 3);
  EXPECT_EQ(Db("query nothing").code, 4);
  EXPECT_EQ(Db("query").code, 2);
  EXPECT_EQ(Db("query calibration-age --since 7d").code, 2) << "a flag the query does not know";
  EXPECT_EQ(Json("sql 'SELECT count(*) AS n FROM frames'")[0]["n"], 3);
  EXPECT_EQ(Shell("echo 'SELECT 1 AS one' | STRATALUX_STORE=" + folder_.string() + " " + STRATALUX_BIN_DIR +
                  "/stratalux-db sql - --csv")
                .out,
            "one\r\n1\r\n");
  EXPECT_EQ(Db("sql 'DELETE FROM frames'").code, 2);
  EXPECT_THAT(Db("sql 'DELETE FROM frames'", "2>&1").out, HasSubstr("only reads"));
  const std::string many = "\"WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x+1 FROM c) SELECT x FROM c\"";
  EXPECT_EQ(Db("sql " + many).code, 3) << "cut without being asked to";
  EXPECT_EQ(Db("sql --limit 5 " + many).out, "x\n1\n2\n3\n4\n5\n");
  EXPECT_EQ(Db("sql --limit 5 " + many).code, 0);
  EXPECT_EQ(
      Db("sql --seconds 0.05 \"WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x+1 FROM c) SELECT count(*) FROM c\"")
          .code,
      1);
}

TEST_F(StrataluxDb, DrawsItsStatistics) {
  StoreSession(3);
  const Outcome text = Db("stats --since 7d --until 1970-01-02");
  EXPECT_EQ(text.code, 0);
  EXPECT_THAT(text.out, HasSubstr("1 sessions, 1 complete; 3 frames"));
  EXPECT_TRUE(std::all_of(text.out.begin(), text.out.end(), [](char c) { return c > 0; })) << "ASCII in a pipe";
  EXPECT_EQ(Json("stats --since 7d --until 1970-01-02")["sessions"], 1);
  const auto page = folder_ / "stats.html";
  EXPECT_EQ(Db("stats --html " + page.string()).code, 0);
  EXPECT_GT(std::filesystem::file_size(page), 1000U);
  EXPECT_EQ(Db("stats --html /nowhere/at/all.html").code, 1);
}

TEST_F(StrataluxDb, KeepsMessagesOffStdout) {
  const Outcome outcome = Db("show nobody");
  EXPECT_EQ(outcome.out, "");
  EXPECT_THAT(Db("show nobody", "2>&1").out, HasSubstr("nobody"));
  EXPECT_EQ(Db("ls", ">/dev/full 2>/dev/null").code, 1) << "a full disk must not pass for success";
}

}  // namespace
}  // namespace stratalux::db
