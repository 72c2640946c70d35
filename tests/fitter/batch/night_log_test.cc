// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/night_log.h"

#include <fstream>

#include <gmock/gmock.h>
#include <sys/stat.h>

#include "db/ledger/ledger_line.h"
#include "db/privacy/forget.h"
#include "fitter/batch/night_status.h"
#include "tests/db/store_fixture.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;

class NightLogTest : public db::StoreTest {};

TEST_F(NightLogTest, ReadsWhatItWrote) {
  auto log = NightLog::Begin(folder_);
  ASSERT_TRUE(log.ok()) << log.status().message();
  const NightEvent done{
      NightEventKind::kDone, {1'800'000'000'123'456'789}, "s1", "f", 2, 3.5, 4.25, 77, "", "a\nb\"c", 0};
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kBegan, .count = 3}).ok());
  ASSERT_TRUE(log->Add(done).ok());
  const auto record = ReadNight(log->folder());
  ASSERT_TRUE(record.ok());
  ASSERT_EQ(record->events.size(), 2U);
  EXPECT_EQ(record->unread, 0);
  EXPECT_EQ(ToJson(record->events[1]), ToJson(done));
  EXPECT_EQ(record->events[0].count, 3);
  EXPECT_EQ(Nights(folder_), std::vector<std::string>{log->folder().filename().string()});
  struct stat file {};
  ASSERT_EQ(stat((log->folder() / "s1.jsonl").c_str(), &file), 0);
  EXPECT_EQ(file.st_mode & 07, 0U) << "it names visitors' sessions";
}

TEST_F(NightLogTest, WritesIntoItsFolderAlone) {
  auto log = NightLog::Begin(folder_);
  ASSERT_TRUE(log.ok());
  for (const std::string& session : {std::string("../s1"), (folder_ / "s1").string(), std::string(".s1")})
    EXPECT_EQ(log->Add({.kind = NightEventKind::kLeftOut, .session = session}).code(), StatusCode::kUsage) << session;
  EXPECT_TRUE(std::filesystem::is_empty(log->folder()));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "s1.jsonl"));
}

TEST_F(NightLogTest, NightsOfOneSecondStandInTheirOrder) {
  constexpr int64_t kMoment = 1'800'000'000'123'456'789;
  EXPECT_EQ(NightMoment({kMoment}), "20270115T080000.123Z");
  // By the number of a process 9999 would stand behind 10012.
  for (const std::string& name : {NightMoment({kMoment}) + "-9999", NightMoment({kMoment + 40'000'000}) + "-10012"})
    ASSERT_TRUE(NightLog::Open(folder_, name).ok());
  EXPECT_EQ(Nights(folder_), (std::vector<std::string>{"20270115T080000.123Z-9999", "20270115T080000.163Z-10012"}));
}

TEST_F(NightLogTest, WhatIsDamagedOrOfALaterVersionIsCountedAndTheRestRead) {
  auto log = NightLog::Begin(folder_);
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kStarted, .session = "s1", .attempt = 1}).ok());
  std::ofstream(log->folder() / "s1.jsonl", std::ios::app)
      << "{\"event\": \"danced\"}\n[]\n{\"event\": 3}\n{\"event\": \"done\", \"attempt\": \"x\"}\n{\"event\": \"do";
  const auto record = ReadNight(log->folder());
  ASSERT_TRUE(record.ok());
  EXPECT_EQ(record->events.size(), 1U);
  EXPECT_EQ(record->unread, 5);
  EXPECT_EQ(ReadNight(folder_ / "none").status().code(), StatusCode::kNotFound);
}

TEST_F(NightLogTest, AVisitorsLastWordCounts) {
  const NightStatus night = StatusOf({{.kind = NightEventKind::kBegan, .count = 2},
                                      {.kind = NightEventKind::kLeftOut, .session = "s0", .why = "consent"},
                                      {.kind = NightEventKind::kStarted, .session = "s1", .fit = "f", .attempt = 1},
                                      {.kind = NightEventKind::kStarted, .session = "s2", .attempt = 1},
                                      {.kind = NightEventKind::kRetry, .session = "s1", .peak_bytes = 9, .reason = "x"},
                                      {.kind = NightEventKind::kStarted, .session = "s1", .attempt = 2},
                                      {.kind = NightEventKind::kDone, .session = "s1", .seconds = 4, .peak_bytes = 5}});
  ASSERT_EQ(night.visits.size(), 2U);
  EXPECT_EQ(night.visits[0].kind, NightEventKind::kDone);
  EXPECT_EQ(night.visits[0].fit, "f");
  EXPECT_EQ(night.visits[0].attempts, 2);
  EXPECT_EQ(night.visits[0].peak_bytes, 9);
  EXPECT_EQ(night.visits[0].reason, "");
  EXPECT_EQ(night.visits[1].kind, NightEventKind::kStarted);
  EXPECT_EQ(night.Over(), 1);
  EXPECT_EQ(night.left_out.size(), 1U);
  EXPECT_FALSE(night.ended);
}

// A forgetting that is over wipes nothing more: what is written behind it, unasked, would stay.
TEST_F(NightLogTest, WhoIsForgottenIsNotNamedThoughTheLedgerCannotBeRead) {
  const std::string gone = StoreSession(1), stays = StoreSession(1);
  auto log = NightLog::Begin(folder_);
  ASSERT_TRUE(log.ok());
  Logger quiet(LogLevel::kError);
  db::ForgetRequest request;
  request.sessions = {gone};
  ASSERT_TRUE(db::Forget(folder_, request, quiet).ok());
  const std::string said = R"({"schema":99,"kind":"sealing")";
  WriteText(folder_ / "ledger" / "0123456789abcdef0123456789abcdef.jsonl",
            said + ",\"hash\":\"" + db::LedgerHash(said + "}") + "\"}\n");
  for (const std::string& session : {gone, stays})
    ASSERT_TRUE(log->Add({.kind = NightEventKind::kDone, .session = session, .fit = "f-" + session}).ok());
  for (const auto& entry : std::filesystem::directory_iterator(log->folder())) {
    EXPECT_EQ(entry.path().string().find(gone), std::string::npos);
    EXPECT_EQ(ReadText(entry.path()).find(gone), std::string::npos) << entry.path();
  }
  const NightStatus night = StatusOf(ReadNight(log->folder())->events);
  EXPECT_EQ(night.Count(NightEventKind::kDone), 2);
  EXPECT_TRUE(std::filesystem::exists(log->folder() / (stays + ".jsonl"))) << "of whose session is there";
}

TEST_F(NightLogTest, AClockThatWasSetBackTurnsNoStoryAround) {
  auto log = NightLog::Begin(folder_);
  ASSERT_TRUE(log.ok());
  constexpr int64_t kHour = 3'600'000'000'000;
  const WallNs late{1'800'000'000'000'000'000}, early{late.ns - kHour};
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kBegan, .at = late, .count = 2}).ok());
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kStarted, .at = late, .session = "s1"}).ok());
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kStarted, .at = {late.ns + 1}, .session = "s2"}).ok());
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kDone, .at = early, .session = "s1"}).ok());
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kRetry, .at = early, .session = "s2"}).ok());
  ASSERT_TRUE(log->Add({.kind = NightEventKind::kDone, .at = {early.ns + 1}, .session = "s2"}).ok());
  const NightStatus night = StatusOf(ReadNight(log->folder())->events);
  ASSERT_EQ(night.visits.size(), 2U);
  EXPECT_EQ(night.visits[0].session, "s1");
  EXPECT_EQ(night.Count(NightEventKind::kDone), 2);
}

// What a unit asks that is begun again when the night is over.
TEST_F(NightLogTest, ANightThatFailedOrNeverBeganIsToldByTheNextOne) {
  const WallNs since{1'800'000'000'000'000'000}, before{since.ns - 1}, later{since.ns + 1};
  int nights = 0;
  const auto check = [&](const std::vector<NightEvent>& events) {
    auto log = NightLog::Open(folder_, std::to_string(nights++));
    EXPECT_TRUE(log.ok());
    for (const NightEvent& event : events) EXPECT_TRUE(log->Add(event).ok());
    const Status status = CheckNewestNight(folder_, since);
    EXPECT_TRUE(status.ok() || status.code() == StatusCode::kDegraded) << status.message();
    return status.message();
  };
  EXPECT_EQ(CheckNewestNight(folder_, since).code(), StatusCode::kDegraded) << "there was none";
  const NightEvent began{.kind = NightEventKind::kBegan, .at = since, .count = 1};
  const NightEvent done{.kind = NightEventKind::kDone, .at = since, .session = "s1"};
  const NightEvent ended{.kind = NightEventKind::kEnded, .at = later, .reason = "stopped"};
  EXPECT_EQ(check({began, done, ended}), "");
  EXPECT_THAT(check({{.kind = NightEventKind::kBegan, .at = before}, done, ended}),
              HasSubstr("no night has begun since"));
  EXPECT_THAT(check({began, done}), HasSubstr("was cut off"));
  NightEvent failed = ended;
  failed.reason = "no space left";
  failed.by_error = true;
  EXPECT_THAT(check({began, done, failed}), HasSubstr("ended by an error: no space left"));
  EXPECT_THAT(check({failed}), HasSubstr("ended by an error")) << "before it began";
  EXPECT_THAT(check({}), HasSubstr("no night has begun"));
  for (const NightEventKind kind : {NightEventKind::kFailed, NightEventKind::kSetAside})
    EXPECT_THAT(check({began, {.kind = kind, .at = since, .session = "s1"}, ended}),
                HasSubstr("1 visitors could not be fitted"));
  EXPECT_EQ(check({began, ended}), "") << "the newest counts";
}

TEST_F(NightLogTest, EachWhoWasForgottenCounts) {
  const NightStatus night = StatusOf({{.kind = NightEventKind::kStarted, .attempt = 1},
                                      {.kind = NightEventKind::kDropped, .reason = "was forgotten"},
                                      {.kind = NightEventKind::kStarted, .attempt = 1},
                                      {.kind = NightEventKind::kDropped, .reason = "was forgotten"}});
  ASSERT_EQ(night.visits.size(), 2U);
  EXPECT_EQ(night.Count(NightEventKind::kDropped), 2);
  EXPECT_EQ(night.Over(), 2);
}

}  // namespace
}  // namespace stratalux::fit
