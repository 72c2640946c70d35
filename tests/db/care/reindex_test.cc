// SPDX-License-Identifier: Apache-2.0
// The index can be lost: what it said is in the files.
#include "db/care/reindex.h"

#include <chrono>
#include <fstream>
#include <thread>

#include <gmock/gmock.h>

#include "db/care/verify.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/session_index.h"
#include "db/privacy/access_log.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// Every column of every row of the tables that `reindex` promises, as text.
std::vector<std::string> Dump(const std::filesystem::path& store) {
  std::vector<std::string> rows;
  auto index = SessionIndex::Open(store, AccessMode::kReadOnly);
  EXPECT_TRUE(index.ok()) << index.status().message();
  for (const char* table : {"sessions", "calibrations", "frames", "proofs", "fits", "metrics", "accepted_calibrations",
                            "visitors", "consents", "deletions"}) {
    auto columns = index->connection().Prepare(
        "SELECT group_concat('quote(' || name || ')', '||''|''||') FROM"
        " pragma_table_info('" +
        std::string(table) + "')");
    EXPECT_TRUE(*columns->Step());
    auto select = index->connection().Prepare("SELECT " + columns->Text(0) + " FROM " + table + " ORDER BY 1");
    while (*select->Step()) rows.push_back(std::string(table) + ": " + select->Text(0));
  }
  return rows;
}

class ReindexTest : public StoreTest {
 protected:
  // A session with everything a manifest can hold.
  std::string StoreVisit(const std::string& visitor, int64_t started_ns) const {
    SessionStore store = OpenStore();
    SessionInfo info;
    info.rig = "bench";
    info.visitor = visitor;
    info.consent = {"v3", "de", true, false, true, {started_ns - 5}};
    info.retention = Retention::kLong;
    info.simulated = true;
    info.seed = 0xfedcba9876543210U;
    info.started_wall.ns = started_ns;
    info.program_version = "0.2";
    info.plan_json = PlanOptionsToJson({});
    info.calibration_json = R"({"schema":1,"id":"c1","source":"somebody"})";
    info.visit = "evening \"7\"";
    info.attempt = 3;
    EXPECT_TRUE(GiveConsent(folder_, visitor, info.consent).ok());
    auto writer = store.BeginSession(info, {.group_frames = 2, .max_segment_bytes = 900});
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < 7; ++i) EXPECT_TRUE(AppendTo(*writer, i).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kDegraded, {"a reason, \"quoted\"", "another"}, SomeFindings()).ok());
    return writer->info().id;
  }
  ReindexReport Rebuild() {
    auto report = Reindex(folder_, logger_);
    EXPECT_TRUE(report.ok()) << report.status().message();
    return report.ok() ? *report : ReindexReport{};
  }
  void LoseIndex() const {
    for (const char* suffix : {"", "-wal", "-shm"})
      std::filesystem::remove(folder_ / ("index.sqlite" + std::string(suffix)));
  }

  Logger logger_{LogLevel::kError};
};

TEST_F(ReindexTest, TellsWhatTheLostIndexTold) {
  // Wall clocks that run backwards: the order of the sessions is not theirs.
  StoreVisit("v-0a11a0a1", 9'000);
  const std::string second = StoreVisit("v-0be00be0", 5'000);
  StoreVisit("v-0a11a0a1", 1'000);
  ASSERT_TRUE(OpenStore().RegisterFit({"f1", second, R"({"eta":1.4})", "{\n \"rms\": 0.25\n}\n", {77}}).ok());
  const auto before = Dump(folder_);
  ASSERT_GT(before.size(), 40U);
  LoseIndex();
  const ReindexReport report = Rebuild();
  EXPECT_EQ(report.sessions, 3);
  EXPECT_EQ(report.frames, 21);
  EXPECT_EQ(report.fits, 1);
  EXPECT_THAT(report.problems, IsEmpty());
  EXPECT_EQ(Dump(folder_), before);
  Rebuild();  // over an intact index as well
  EXPECT_EQ(Dump(folder_), before);
  EXPECT_TRUE(std::filesystem::exists(folder_ / "index-before-reindex-1.sqlite"));
}

TEST_F(ReindexTest, NumbersGoOnBehindTheHighestEverGiven) {
  const std::string first = StoreSession(1), second = StoreSession(1);
  std::filesystem::create_directories(folder_ / "deletions");
  WriteText(folder_ / "deletions" / (second + ".json"),
            R"({"session":")" + second + R"(","reason":"purge","deleted_wall_ns":7})");
  LoseIndex();
  EXPECT_EQ(Rebuild().forgotten, 1);
  const auto sessions = *OpenStore(AccessMode::kReadOnly).ListSessions();
  ASSERT_EQ(sessions.size(), 1U) << "a forgotten session never returns";
  EXPECT_EQ(sessions[0].info.id, first);
  EXPECT_THAT(StoreSession(1), HasSubstr("s000003-"));
}

TEST_F(ReindexTest, AWriterThatDiedLeavesAFailedSessionWithItsWholeFrames) {
  std::string id;
  {
    SessionStore store = OpenStore();
    auto writer = store.BeginSession(SimulatedVisit(), {.group_frames = 1});
    for (int i = 0; i < 3; ++i) ASSERT_TRUE(AppendTo(*writer, i).ok());
    id = writer->info().id;
    EXPECT_EQ(Reindex(folder_, logger_).status().code(), StatusCode::kBusy) << "a live writer";
  }
  std::ofstream(Segment(id), std::ios::app | std::ios::binary) << "FRM1 half a record";
  const auto before = ReadBytes(Segment(id));
  LoseIndex();
  const ReindexReport report = Rebuild();
  EXPECT_EQ(report.frames, 3);
  EXPECT_THAT(report.problems, IsEmpty()) << "what a writer never finished is no damage";
  EXPECT_THAT(report.notes, Contains(AllOf(HasSubstr("frames-0001.seg: bytes " + std::to_string(before.size() - 18) +
                                                     " to " + std::to_string(before.size())),
                                           HasSubstr("set aside"))));
  EXPECT_EQ(ReadBytes(Segment(id)), before) << "a rebuild writes to no segment";
  const auto row = *OpenStore(AccessMode::kReadOnly).FindSession(id);
  EXPECT_EQ(row.info.status, SessionStatus::kFailed);
  EXPECT_THAT(row.info.reasons, Contains(HasSubstr("3 whole frames")));
}

TEST_F(ReindexTest, AnyFlippedByteOfASealedSegmentLosesNoFrame) {
  const std::string id = StoreSession(3);
  const auto bytes = ReadBytes(Segment(id));
  for (size_t at = 0; at < bytes.size(); at += 13) {
    FlipBits(Segment(id), at, 0x21);
    LoseIndex();
    const auto report = Reindex(folder_, logger_);
    ASSERT_TRUE(report.ok()) << report.status().message();
    // The manifest knows the footer, and the footer the headers.
    const bool in_payload = at >= 64 && at < 64 + 3 * (320 + 36) && (at - 64) % (320 + 36) >= 320;
    EXPECT_EQ(report->frames, 3) << "byte " << at;
    EXPECT_EQ(report->problems.empty(), in_payload) << "byte " << at;  // `verify --deep` hashes those
    EXPECT_EQ(OpenStore(AccessMode::kReadOnly).FindSession(id)->info.status, SessionStatus::kComplete);
    FlipBits(Segment(id), at, 0x21);
    EXPECT_EQ(ReadBytes(Segment(id)), bytes) << "byte " << at;
  }
}

// The disk was full before the first byte: a folder without a manifest.
TEST_F(ReindexTest, ASessionThatNeverBeganIsANoteToEverybody) {
  const std::string id = StoreSession(1);
  const auto folder = folder_ / "sessions" / "s000009-0badcafe";
  std::filesystem::create_directories(folder);
  const auto expect_note = [&] {
    const ReindexReport report = Rebuild();
    EXPECT_THAT(report.problems, IsEmpty());
    EXPECT_THAT(report.notes, Contains(HasSubstr("s000009-0badcafe has no manifest and no frame")));
    EXPECT_EQ(report.sessions, 1);
    const auto verified = VerifyStore(OpenStore(AccessMode::kReadOnly));
    EXPECT_THAT(verified->problems, IsEmpty());
    EXPECT_THAT(verified->notes, Contains(HasSubstr("s000009-0badcafe has no manifest and no frame")));
  };
  expect_note();
  WriteText(folder / "manifest.json.new", "{");
  const auto header = ReadBytes(Segment(id));
  WriteBytes(folder / "frames-0001.seg", {header.begin(), header.begin() + 64});
  WriteBytes(folder / "truth.seg", {});
  expect_note();
}

// As far as files and ledger tell: bytes that may be a frame, or a first frame that was acknowledged once, are a loss.
TEST_F(ReindexTest, ASessionThatBeganAndLostItsManifestIsNone) {
  const std::string id = StoreSession(2);
  const auto folder = folder_ / "sessions" / id;
  std::filesystem::remove(folder / "manifest.json");
  const auto segment = ReadBytes(Segment(id));
  WriteBytes(Segment(id), {segment.begin(), segment.begin() + 200});
  const auto expect_problem = [&] {
    const ReindexReport report = Rebuild();
    EXPECT_THAT(report.problems, Contains(HasSubstr(id)));
    EXPECT_THAT(VerifyStore(OpenStore(AccessMode::kReadOnly))->problems, Contains(HasSubstr(id)));
  };
  LoseIndex();
  expect_problem();
  std::filesystem::remove(Segment(id));
  LoseIndex();
  expect_problem();  // the ledger knows of its first frame
  std::filesystem::remove_all(folder_ / "ledger");
  LoseIndex();
  EXPECT_THAT(Rebuild().problems, IsEmpty()) << "nothing is left that could tell";
}

TEST_F(ReindexTest, RefusesWhileAProgramReadsTheOldIndex) {
  StoreSession(1);
  const SessionStore reader = OpenStore(AccessMode::kReadOnly);
  ASSERT_TRUE(reader.ListSessions().ok());
  EXPECT_EQ(Reindex(folder_, logger_).status().code(), StatusCode::kBusy);
  EXPECT_EQ(reader.ListSessions()->size(), 1U);
}

TEST_F(ReindexTest, ADamagedIndexIsReplacedAndKept) {
  StoreSession(2);
  WriteText(folder_ / "index.sqlite",
            "this was a database once, or so they say, and it is long enough for a header page");
  EXPECT_EQ(Rebuild().frames, 2);
  EXPECT_EQ(ReadBytes(folder_ / "index-before-reindex-1.sqlite").size(), 81U);
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  EXPECT_THAT(VerifyStore(store)->problems, IsEmpty());
}

// A writer that opened the old index waits for it: what it writes must not go where nobody reads again.
TEST_F(ReindexTest, WhatIsWrittenWhileTheNewIndexTakesItsPlaceIsRefusedOrFound) {
  using namespace std::chrono_literals;
  StoreVisit("v-0a11a0a1", 9'000);
  const std::string late = "v-0be00be0";
  Status given, logged;
  std::thread consent, log;
  const auto report = Reindex(folder_, logger_, [&] {
    consent = std::thread([&] { given = GiveConsent(folder_, late, {"v3", "de", true, false, true, {}}); });
    log = std::thread([&] { logged = LogAccess(folder_, "export", "", "vm:/tmp/pictures"); });
    std::this_thread::sleep_for(300ms);  // both have the old file open by then, and wait
  });
  if (consent.joinable()) consent.join();
  if (log.joinable()) log.join();
  ASSERT_TRUE(report.ok()) << report.status().message();
  if (given.ok())
    EXPECT_EQ(ListConsents(folder_, late)->size(), 1U);
  else
    EXPECT_EQ(given.code(), StatusCode::kBusy) << given.message();
  if (logged.ok())
    EXPECT_EQ(ListAccess(folder_, "")->size(), 1U);
  else
    EXPECT_EQ(logged.code(), StatusCode::kBusy) << logged.message();
  EXPECT_TRUE(GiveConsent(folder_, late, {"v3", "de", true, false, true, {}}).ok()) << "the new one takes it";
}

}  // namespace
}  // namespace stratalux::db
