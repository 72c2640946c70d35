// SPDX-License-Identifier: Apache-2.0
// What the morning's report says, of figures that are known.
#include "fitter/batch/morning_report.h"

#include <gmock/gmock.h>

#include "db/ledger/ledger.h"
#include "db/ledger/ledger_line.h"
#include "db/privacy/forget.h"
#include "tests/db/store_fixture.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

std::string Row(const char* light, const char* model, const char* geometry, const char* part, const char* direct,
                double error) {
  return std::string(R"({"light": ")") + light + R"(", "model": ")" + model + R"(", "geometry": ")" + geometry +
         R"(", "part": ")" + part + R"(", "direct": ")" + direct + R"(", "nrmse_without_noise": )" +
         std::to_string(error) + "}";
}

// As a full evaluation writes them: of the projector that the fit held out first, then of another.
std::string Metrics(double error, double divergence = 0.003) {
  return R"({"prediction": [)" + Row("white", "tied", "reconstructed", "total", "predicted", 9) + "," +
         Row("stripe", "mean", "reconstructed", "total", "predicted", 8) + "," +
         Row("stripe", "tied", "truth", "total", "predicted", 7) + "," +
         Row("stripe", "tied", "reconstructed", "total", "predicted", error) + "," +
         Row("stripe", "tied", "reconstructed", "total", "separated", 6) + "," +
         Row("stripe", "tied", "reconstructed", "subsurface", "separated", 5) + "," +
         Row("stripe", "tied", "reconstructed", "total", "predicted", 4) +
         R"(], "coverage": [{"judged": 30, "lit_skin": 40, "geometry": "reconstructed"},
    {"judged": 10, "lit_skin": 40, "geometry": "reconstructed"}, {"judged": 5, "lit_skin": 40, "geometry": "truth"}],
    "fit": {"divergence": )" +
         std::to_string(divergence) + R"(}, "drift": {"projectors": [{"shift_px": 0.25}, {"shift_px": 0.5}, {}]},
    "stages": [{"name": "srd", "cpu_seconds": 2}, {"name": "fit", "cpu_seconds": 5}, {"name": "fit", "cpu_seconds": 1}]})";
}

TEST(FiguresOf, AreTheJudgedModelsOnTheReconstructedSurface) {
  const Figures figures = FiguresOf(Metrics(0.04));
  EXPECT_EQ(figures,
            (Figures{{"error of stripes, %", 4.0}, {"coverage, %", 75.0}, {"divergence", 0.003}, {"drift, px", 0.5}}));
  EXPECT_EQ(StageSecondsOf(Metrics(0.04)), (Figures{{"srd", 2.0}, {"fit", 6.0}}));
}

// Nobody knows what of a real face the light truly reaches.
TEST(FiguresOf, CoverageOfARealCaptureIsOfTheSurfaceThatCounts) {
  const Figures figures = FiguresOf(R"({"coverage": [{"judged": 60, "lit_skin": 0, "geometry": "reconstructed",
    "unlit": 20, "not_fitted": 15, "not_separated": 5, "not_skin": 900, "in_shadow": 90}]})");
  EXPECT_EQ(figures, (Figures{{"coverage, %", 60.0}}));
}

TEST(FiguresOf, WhatIsNotThereOrOfAnotherFormIsLeftOut) {
  for (const char* text :
       {"", "{", "[]", "{}", R"({"prediction": 3, "coverage": [1], "fit": 7, "drift": [], "stages": {}})",
        R"({"prediction": [{"light": 1, "model": "tied"}], "coverage": [{"judged": 1, "lit_skin": 0}]})"}) {
    EXPECT_THAT(FiguresOf(text), IsEmpty()) << text;
    EXPECT_THAT(StageSecondsOf(text), IsEmpty()) << text;
  }
}

// Nobody is to take it for the best of all.
TEST(FiguresOf, ADriftThatWasNotJudgedIsNone) {
  const std::string none = R"({"projector": 0, "points": 31, "shift_px": 0.0})",
                    judged = R"({"projector": 1, "points": 900, "shift_px": 0.25})";
  EXPECT_THAT(FiguresOf(R"({"drift": {"projectors": [)" + none + "]}}"), IsEmpty());
  EXPECT_EQ(FiguresOf(R"({"drift": {"projectors": [)" + none + "," + judged + "]}}"), (Figures{{"drift, px", 0.25}}));
}

// 9 fits around 4 with a median deviation of 0.2: a standard deviation of 0.2965, so that 1.04 is far.
TEST(OutliersOf, AreFarFromTheStoresOwnFits) {
  std::vector<Figures> earlier;
  for (const double error : {3.6, 3.7, 3.8, 3.9, 4.0, 4.1, 4.2, 4.3, 4.4}) earlier.push_back({{"e", error}});
  EXPECT_THAT(OutliersOf("s", {{"e", 5.0}}, earlier), IsEmpty());
  const auto far = OutliersOf("s", {{"e", 5.1}, {"new", 1.0}}, earlier);
  ASSERT_THAT(far, SizeIs(1));
  EXPECT_EQ(far[0].figure, "e");
  EXPECT_NEAR(far[0].usual, 4.0, 1e-12);
  EXPECT_NEAR(far[0].spread, 0.29652, 1e-5);
  EXPECT_THAT(OutliersOf("s", {{"e", 2.9}}, earlier), SizeIs(1)) << "too good is as strange";
  earlier.resize(7);
  EXPECT_THAT(OutliersOf("s", {{"e", 50.0}}, earlier), IsEmpty()) << "too few to say";
}

void AddNow(NightLog& log, NightEvent event) {
  event.at = WallNow();
  ASSERT_TRUE(log.Add(event).ok());
}

class MorningReportTest : public db::StoreTest {
 protected:
  std::string Fitted(double error, WallNs at) {
    const std::string session = StoreSession(1);
    auto store = OpenStore();
    const auto folder = store.FitFolder(session, "f1");
    std::filesystem::create_directories(folder);
    WriteText(folder / "metrics.json", Metrics(error));
    const Status entered = store.RegisterFit({"f1", session, "{}", Metrics(error), at});
    EXPECT_TRUE(entered.ok()) << entered.message();
    return session;
  }
};

TEST_F(MorningReportTest, SaysWhoWasFittedWhoNotWhoIsStrangeAndHowLongTheDiskLasts) {
  const WallNs before{WallNow().ns - 1'000'000'000};
  for (const double error : {0.036, 0.037, 0.038, 0.039, 0.04, 0.041, 0.042, 0.043}) Fitted(error, before);
  auto log = NightLog::Begin(folder_);
  ASSERT_TRUE(log.ok());
  const std::string good = Fitted(0.0401, WallNow()), strange = Fitted(0.09, WallNow()), bad = StoreSession(1);
  AddNow(*log, {.kind = NightEventKind::kBegan, .count = 3});
  // As of a time before its fits.
  NightEvent began{.kind = NightEventKind::kBegan, .at = {before.ns + 1}, .count = 3};
  ASSERT_TRUE(log->Add(began).ok());
  AddNow(*log,
         {.kind = NightEventKind::kLeftOut, .session = "s9-consent", .why = "consent", .reason = "was withdrawn"});
  AddNow(*log,
         {.kind = NightEventKind::kLeftOut, .session = "s9-complete", .why = "complete", .reason = "is complete"});
  for (const std::string& session : {good, strange}) {
    AddNow(*log, {.kind = NightEventKind::kStarted, .session = session, .fit = "f1", .attempt = 1});
    AddNow(*log, {.kind = NightEventKind::kDone,
                  .session = session,
                  .fit = "f1",
                  .attempt = 1,
                  .seconds = 12,
                  .cpu_seconds = 20});
  }
  // The queue counts on from an earlier night, and names logs by that; of whom no worker began there is none.
  AddNow(*log, {.kind = NightEventKind::kStarted, .session = bad, .fit = "f2", .attempt = 2});
  AddNow(*log, {.kind = NightEventKind::kFailed, .session = bad, .attempt = 2, .reason = "no <light>\x1b[2J"});
  AddNow(*log, {.kind = NightEventKind::kFailed, .session = "s9-no-key", .reason = "no key"});
  WriteText(log->WorkerLog(bad, 2), "log");
  AddNow(*log, {.kind = NightEventKind::kEnded, .seconds = 24});

  const auto facts = GatherMorning(folder_, log->folder().filename().string());
  ASSERT_TRUE(facts.ok()) << facts.status().message();
  EXPECT_EQ(facts->earlier, 8U);
  ASSERT_THAT(facts->outliers, SizeIs(1));
  EXPECT_EQ(facts->outliers[0].session, strange);
  ASSERT_TRUE(facts->nights_left);
  int64_t bytes = 0;
  for (const FittedVisit& visit : facts->fitted) bytes += visit.bytes;
  EXPECT_NEAR(*facts->nights_left, static_cast<double>(facts->free_bytes) / static_cast<double>(bytes), 1e-9);

  const auto page = WriteMorningReport(folder_, log->folder().filename().string());
  ASSERT_TRUE(page.ok()) << page.status().message();
  const std::string html = ReadText(*page), text = ReadText(page->parent_path() / "report.txt");
  for (const std::string& said : {html, text}) {
    EXPECT_THAT(said, HasSubstr("2 of 3 visitors fitted, 2 failed; 1 figures to look at."));
    EXPECT_THAT(said, HasSubstr("s9-consent"));
    EXPECT_THAT(said, Not(HasSubstr("s9-complete"))) << "many, and nobody's worry";
    EXPECT_THAT(said, Not(HasSubstr("\x1b")));
  }
  EXPECT_THAT(html, HasSubstr("<a href=\"../../sessions/" + good + "/fits/f1/report/index.html\">"));
  EXPECT_THAT(html, HasSubstr("<a href=\"" + bad + "-2.log\">"));
  EXPECT_THAT(html, HasSubstr("s9-no-key"));
  EXPECT_THAT(html, Not(HasSubstr("s9-no-key-"))) << "a link to a log that is not there";
  EXPECT_THAT(html, Not(HasSubstr("no <light>")));
  EXPECT_THAT(text, HasSubstr(strange + "  error of stripes, %  9.000"));
}

// Gathered before, written after: neither the id nor the figures come back.
TEST_F(MorningReportTest, WhoIsForgottenWhileItIsMadeIsNotInIt) {
  auto log = NightLog::Begin(folder_);
  ASSERT_TRUE(log.ok());
  const std::string stays = Fitted(0.04, WallNow()), fitted = Fitted(0.05, WallNow()), left_out = StoreSession(1);
  AddNow(*log, {.kind = NightEventKind::kBegan, .count = 2});
  AddNow(*log, {.kind = NightEventKind::kLeftOut, .session = left_out, .why = "key", .reason = "no key"});
  for (const std::string& session : {stays, fitted})
    AddNow(*log, {.kind = NightEventKind::kDone, .session = session, .fit = "f1", .attempt = 1, .seconds = 12});
  std::vector<std::string> waiting = {fitted, left_out};
  const auto page = WriteMorningReport(folder_, log->folder().filename().string(), [&] {
    if (waiting.empty()) return;
    Logger quiet(LogLevel::kError);
    db::ForgetRequest request;
    request.sessions = {waiting.back()};
    waiting.pop_back();
    const auto forgotten = db::Forget(folder_, request, quiet);
    EXPECT_TRUE(forgotten.ok()) << forgotten.status().message();
  });
  ASSERT_TRUE(page.ok()) << page.status().message();
  EXPECT_THAT(waiting, IsEmpty());
  EXPECT_THAT(ReadText(*page), HasSubstr(stays));
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder_ / "nights"))
    for (const std::string& gone : {fitted, left_out}) {
      EXPECT_THAT(entry.path().filename().string(), Not(HasSubstr(gone)));
      const std::string text = entry.is_regular_file() ? ReadText(entry.path()) : "";
      EXPECT_THAT(text, Not(HasSubstr(gone))) << entry.path();
    }
}

// Whether somebody was is not known: a page that may name them is none.
TEST_F(MorningReportTest, WhereItCannotBeAskedWhoIsForgottenThereIsNoPage) {
  auto log = NightLog::Begin(folder_);
  ASSERT_TRUE(log.ok());
  const std::string session = Fitted(0.05, WallNow());
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kBegan, .at = WallNow(), .count = 1}).ok());
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kDone, .at = WallNow(), .session = session, .fit = "f1"}).ok());
  const std::string night = log->folder().filename().string();
  ASSERT_TRUE(WriteMorningReport(folder_, night).ok());
  const std::filesystem::path later = folder_ / "ledger" / "0123456789abcdef0123456789abcdef.jsonl";
  const auto page = WriteMorningReport(folder_, night, [&] {
    Logger quiet(LogLevel::kError);
    db::ForgetRequest request;
    request.sessions = {session};
    const auto forgotten = db::Forget(folder_, request, quiet);
    EXPECT_TRUE(forgotten.ok()) << forgotten.status().message();
    const std::string said = R"({"schema":99,"kind":"sealing")";
    WriteText(later, said + ",\"hash\":\"" + db::LedgerHash(said + "}") + "\"}\n");
  });
  EXPECT_EQ(page.status().code(), StatusCode::kNewerSchema) << page.status().message();
  EXPECT_FALSE(std::filesystem::exists(log->folder() / "report.html"));
  EXPECT_FALSE(std::filesystem::exists(log->folder() / "report.txt"));
  for (const auto& entry : std::filesystem::directory_iterator(log->folder()))
    EXPECT_THAT(ReadText(entry.path()), Not(HasSubstr(session))) << entry.path();
  EXPECT_EQ(WriteMorningReport(folder_, night).status().code(), StatusCode::kNewerSchema);
  std::filesystem::remove(later);
  EXPECT_TRUE(WriteMorningReport(folder_, night).ok());
}

// The ledger has the forgetting before the nights' files go.
TEST_F(MorningReportTest, WhoseForgettingHasBegunIsNotInIt) {
  auto log = NightLog::Begin(folder_);
  ASSERT_TRUE(log.ok());
  const std::string session = Fitted(0.05, WallNow());
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kBegan, .at = WallNow(), .count = 1}).ok());
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kDone, .at = WallNow(), .session = session, .fit = "f1"}).ok());
  ASSERT_TRUE(db::AppendToLedger(folder_, {db::LedgerKind::kForgetting, WallNow(), {session}, "", "{}"}).ok());
  const auto page = WriteMorningReport(folder_, log->folder().filename().string());
  ASSERT_TRUE(page.ok()) << page.status().message();
  EXPECT_THAT(ReadText(*page), Not(HasSubstr(session)));
  EXPECT_THAT(ReadText(page->parent_path() / "report.txt"), Not(HasSubstr(session)));
}

}  // namespace
}  // namespace stratalux::fit
