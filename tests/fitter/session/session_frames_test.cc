// SPDX-License-Identifier: Apache-2.0
// Frames that several threads read are those that one reads, and dark frames are read once.
#include "fitter/session/session_frames.h"

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <tuple>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "db/base/sqlite.h"
#include "db/segment/segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;

constexpr int kFrames = 12, kProjectors = 4;

class SessionFramesTest : public db::StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    setenv("STRATALUX_THREADS", "3", 1);
  }
  void TearDown() override {
    unsetenv("STRATALUX_THREADS");
    StoreTest::TearDown();
  }
  // Frames of black, a projector in turn.
  [[nodiscard]] std::string BlackFrames() const {
    db::SessionStore store = OpenStore();
    auto writer = store.BeginSession(db::SimulatedVisit());
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < kFrames; ++i) {
      FrameRecord record = db::RecordFor(i, PixelFormat::kMono12, 6, 4);
      record.pattern = {.kind = PatternKind::kBlack};
      record.bracket = 0;
      EXPECT_TRUE(writer->Append(record, db::PixelsFor(record).view()).ok());
    }
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    return writer->info().id;
  }
  [[nodiscard]] SessionFrames Open(const std::string& session) const {
    auto frames = SessionFrames::Open(folder_.string(), session);
    EXPECT_TRUE(frames.ok()) << frames.status().message();
    return std::move(frames).value();
  }
  static std::vector<const db::FrameRow*> Rows(const SessionFrames& frames) {
    std::vector<const db::FrameRow*> rows;
    for (const db::FrameRow& row : frames.rows()) rows.push_back(&row);
    return rows;
  }
};

TEST_F(SessionFramesTest, ThreadsReadThemInTheirOrder) {
  const SessionFrames frames = Open(StoreSession(kFrames));
  auto rows = Rows(frames);
  std::reverse(rows.begin(), rows.end());
  for (int again = 0; again < 2; ++again) {
    const auto read = frames.ReadAll(rows);
    ASSERT_TRUE(read.ok()) << read.status().message();
    ASSERT_EQ(read->size(), rows.size());
    for (size_t i = 0; i < rows.size(); ++i) {
      const auto alone = frames.ReadLinear(*rows[i]);
      ASSERT_TRUE(alone.ok());
      EXPECT_TRUE(std::ranges::equal((*read)[i].pixels(), alone->pixels())) << i;
    }
  }
  EXPECT_TRUE(frames.ReadAll({}).ok());
}

// Whichever thread comes upon it.
TEST_F(SessionFramesTest, ADamagedFrameIsNamed) {
  const std::string session = StoreSession(kFrames);
  const SessionFrames frames = Open(session);
  const db::FrameRow& damaged = frames.rows()[7];
  db::FlipBits(Segment(session), static_cast<size_t>(damaged.offset) + sizeof(db::FrameHeader), 0x10);
  const auto read = frames.ReadAll(Rows(frames));
  EXPECT_EQ(read.status().code(), StatusCode::kIntegrity);
  const auto alone = frames.ReadRaw(damaged);
  EXPECT_EQ(read.status().message(), alone.status().message());
  EXPECT_THAT(read.status().message(), HasSubstr(session));
}

TEST_F(SessionFramesTest, OnlyWhatIsKeptIsKnown) {
  SessionFrames frames = Open(BlackFrames());
  const auto all = frames.FramesHash();
  ThinPlan thin;
  for (const int i : {1, 5, 6}) thin.kept.push_back(frames.rows()[static_cast<size_t>(i)].record.step);
  ASSERT_TRUE(frames.MeanBlack(0).ok());
  frames.KeepOnly(thin);
  ASSERT_EQ(frames.rows().size(), 3U);
  for (const db::FrameRow& row : frames.rows()) EXPECT_THAT(thin.kept, ::testing::Contains(row.record.step));
  EXPECT_EQ(frames.MeanBlack(0).status().code(), StatusCode::kNotFound);  // even what was read before
  int count = 0;
  EXPECT_TRUE(frames.MeanBlack(1).ok());
  EXPECT_EQ(frames.MeanWhite(1, count).status().code(), StatusCode::kNotFound);
  EXPECT_NE(*frames.FramesHash(), *all);
  // Nor is it the same where one is withdrawn later.
  auto index = db::Connection::Open(folder_ / "index.sqlite", db::Connection::Mode::kReadWrite);
  ASSERT_TRUE(index.ok() && index->Execute("UPDATE frames SET level_check = 2 WHERE frame = 0").ok());
  const auto withdrawn = SessionFrames::Open(folder_.string(), "latest");
  ASSERT_TRUE(withdrawn.ok());
  EXPECT_NE(*withdrawn->FramesHash(), *all);
}

TEST_F(SessionFramesTest, OfAStepShotAgainTheLastGoodFrameCounts) {
  db::SessionStore store = OpenStore();
  auto writer = store.BeginSession(db::SimulatedVisit());
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  using Shot = std::tuple<int, int, LevelCheck>;  // step, retry
  for (const auto& [step, retry, check] :
       {Shot{0, 0, LevelCheck::kPassed}, Shot{1, 0, LevelCheck::kPassed}, Shot{2, 0, LevelCheck::kFailed},
        Shot{0, 1, LevelCheck::kPassed}, Shot{1, 1, LevelCheck::kFailed}, Shot{2, 1, LevelCheck::kNotChecked}}) {
    FrameRecord record = db::RecordFor(step, PixelFormat::kMono12, 6, 4);
    record.trigger_number += 10 * retry;
    record.driver_sequence += 10 * retry;
    record.retry = retry;
    record.level_check = check;
    if (retry > 0) record.retake_cause = step == 0 ? "subject moved" : "wrong level";
    ASSERT_TRUE(writer->Append(record, db::PixelsFor(record).view()).ok());
  }
  ASSERT_TRUE(writer->Finish(SessionStatus::kDegraded).ok());
  std::vector<std::pair<int, int>> counting;
  const SessionFrames frames = Open(writer->info().id);
  for (const db::FrameRow& row : frames.rows())
    if (row.record.level_check != LevelCheck::kFailed) counting.emplace_back(row.record.step, row.record.retry);
  EXPECT_THAT(counting, ::testing::ElementsAre(std::pair(1, 0), std::pair(0, 1), std::pair(2, 1)));
  // Where the subject was before it jumped shows what a jump had shot again, no frame that was shot again for itself.
  ASSERT_EQ(frames.replaced().size(), 2U);
  for (const db::FrameRow& row : frames.replaced())
    EXPECT_EQ(frames.BeforeJump(row), row.record.step == 0) << row.record.step;
}

// A projector is begun anew where something was refuted; the reference, which is asked first, is then shot once more.
TEST_F(SessionFramesTest, AJumpLiesBetweenTheFramesBeforeItAndThoseCapturedAnew) {
  db::SessionStore store = OpenStore();
  auto writer = store.BeginSession(db::SimulatedVisit());
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  struct Shot {
    int step, retry;
    bool refuted;
    const char* cause;
  };
  int64_t number = 0;
  for (const Shot& shot : {Shot{0, 0, false, ""},
                           {1, 0, true, ""},  // a fault of its own
                           {1, 1, false, "wrong level"},
                           {2, 0, true, ""},
                           {0, 1, false, "subject moved"},  // asked
                           {0, 2, false, "subject moved"},
                           {1, 2, false, "subject moved"},
                           {2, 1, false, "subject moved"}}) {
    FrameRecord record = db::RecordFor(shot.step, PixelFormat::kMono12, 6, 4);
    record.projector = 0;
    record.trigger_number = record.driver_sequence = ++number;
    record.trigger_time = MonotonicNs{number * 1'000'000};
    record.retry = shot.retry;
    record.level_check = shot.refuted ? LevelCheck::kFailed : LevelCheck::kPassed;
    record.retake_cause = shot.cause;
    ASSERT_TRUE(writer->Append(record, db::PixelsFor(record).view()).ok());
  }
  ASSERT_TRUE(writer->Finish(SessionStatus::kDegraded).ok());
  SessionFrames frames = Open(writer->info().id);
  const auto shot = [&](int step, int retry) {
    for (const auto* rows : {&frames.rows(), &frames.replaced()})
      for (const db::FrameRow& row : *rows)
        if (row.record.step == step && row.record.retry == retry) return row;
    ADD_FAILURE() << step << " " << retry;
    return db::FrameRow{};
  };
  const db::FrameRow first = shot(0, 0), again = shot(1, 1), asked = shot(0, 1), anew = shot(0, 2);
  for (const bool thinned : {false, true}) {
    EXPECT_FALSE(frames.JumpedBetween(first, again)) << "shot again for itself";
    EXPECT_TRUE(frames.JumpedBetween(first, asked));
    EXPECT_TRUE(frames.JumpedBetween(again, anew));
    EXPECT_FALSE(frames.JumpedBetween(asked, anew)) << "the reference once more";
    ThinPlan thin;
    thin.kept = {0, 1};  // not the step that was refuted
    if (!thinned) frames.KeepOnly(thin);
  }
}

TEST_F(SessionFramesTest, DarkFramesAreReadOnce) {
  const std::string session = BlackFrames();
  SessionFrames frames = Open(session);
  const auto first = frames.MeanBlack(1);
  ASSERT_TRUE(first.ok()) << first.status().message();
  double mean = 0.0;
  for (int i = 1; i < kFrames; i += kProjectors)
    mean += db::PixelsFor(db::RecordFor(i, PixelFormat::kMono12, 6, 4))(3, 2) / 3.0;
  EXPECT_NEAR((*first)(3, 2), mean, 1e-3);
  std::filesystem::rename(Segment(session), Segment(session).string() + ".away");
  const auto again = frames.MeanBlack(1);
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_TRUE(std::ranges::equal(first->pixels(), again->pixels()));
  EXPECT_FALSE(frames.MeanBlack(2).ok()) << "another projector has another";
  // As another record reads the frames they are others.
  frames.UseRecord({});
  EXPECT_FALSE(frames.MeanBlack(1).ok());
}

// A projector's dark frame is guided by its white frames: that one is damaged is no reason to do without.
TEST_F(SessionFramesTest, ADamagedWhiteFrameIsNoMissingOne) {
  db::SessionStore store = OpenStore();
  auto writer = store.BeginSession(db::SimulatedVisit());
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  for (int i = 0; i < kFrames; ++i) {
    FrameRecord record = db::RecordFor(i, PixelFormat::kMono12, 6, 4);
    const bool white = i >= kFrames - kProjectors && i < kFrames - 1;  // of all but the last projector
    record.pattern = {.kind = white ? PatternKind::kWhite : PatternKind::kBlack};
    record.bracket = 0;
    ASSERT_TRUE(writer->Append(record, db::PixelsFor(record).view()).ok());
  }
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  SessionFrames frames = Open(writer->info().id);
  RigCalibration record;
  record.camera.cfa = Cfa::kMono;
  record.camera.gain_e_per_dn = 4.0;
  record.camera.read_noise_dn = 3.0;
  record.camera.saturation_dn = 4095.0;
  frames.UseRecord(record);
  const db::FrameRow& damaged = frames.rows()[kFrames - kProjectors];
  ASSERT_EQ(damaged.record.pattern.kind, PatternKind::kWhite);
  db::FlipBits(Segment(writer->info().id), static_cast<size_t>(damaged.offset) + sizeof(db::FrameHeader), 0x10);
  const auto dark = frames.MeanBlack(damaged.record.projector);
  EXPECT_EQ(dark.status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(dark.status().message(), HasSubstr(writer->info().id));
  EXPECT_TRUE(frames.MeanBlack(1).ok());
  EXPECT_TRUE(frames.MeanBlack(kProjectors - 1).ok()) << "it has no white frame, and needs none";
}

}  // namespace
}  // namespace stratalux::fit
