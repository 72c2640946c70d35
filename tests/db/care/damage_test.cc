// SPDX-License-Identifier: Apache-2.0
// Damage of every kind is found, named and never fatal.
#include <cstdio>
#include <functional>
#include <optional>

#include <gmock/gmock.h>

#include "db/base/sqlite.h"
#include "db/care/verify.h"
#include "db/segment/truth_segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr size_t kFileHeader = 64, kFrameHeader = 320, kPayload = 6 / 2 * 3 * 4;

class DamageTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    id_ = StoreSession(3);
    intact_ = ReadBytes(Segment(id_));
    frames_ = *OpenStore(AccessMode::kReadOnly).ListFrames(id_);
    ASSERT_EQ(intact_.size(), kFileHeader + 3 * (kFrameHeader + kPayload) + 16 + 3 * kFrameHeader + 24);
  }
  [[nodiscard]] std::vector<std::string> Problems(const SessionStore& store) const {
    const auto report = VerifySession(store, *store.FindSession(id_));
    EXPECT_TRUE(report.ok()) << report.status().message();
    return report->problems;
  }

  std::string id_;
  std::vector<uint8_t> intact_;
  std::vector<FrameRow> frames_;
};

TEST_F(DamageTest, AnIntactSessionHasNone) { EXPECT_THAT(Problems(OpenStore(AccessMode::kReadOnly)), IsEmpty()); }

TEST_F(DamageTest, AFlippedBitInAnyByteIsFoundAndItsFileNamed) {
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  for (size_t i = 0; i < intact_.size(); ++i) {
    const auto mask = static_cast<uint8_t>(1U << (i % 8));
    FlipBits(Segment(id_), i, mask);
    ASSERT_THAT(Problems(store), Contains(HasSubstr("frames-0001.seg"))) << "byte " << i;
    FlipBits(Segment(id_), i, mask);
  }
  std::printf(
      "%zu bytes of a segment flipped and found: %zu of the file header, %zu of frame headers, %zu of payloads,"
      " %zu of the footer, 24 of the trailer\n",
      intact_.size(), kFileHeader, 3 * kFrameHeader, 3 * kPayload, 16 + 3 * kFrameHeader);
}

// One in a header spoils none: the footer has a copy.
TEST_F(DamageTest, AFlippedBitSpoilsItsFrameAndNoOther) {
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  for (size_t spoilt = 0; spoilt < frames_.size(); ++spoilt) {
    const auto start = static_cast<size_t>(frames_[spoilt].offset);
    for (size_t at = start; at < start + kFrameHeader + kPayload; at += 7) {
      FlipBits(Segment(id_), at, 0x10);
      for (size_t i = 0; i < frames_.size(); ++i) {
        const auto image = store.ReadFrame(id_, frames_[i]);
        ASSERT_EQ(image.ok(), i != spoilt || at < start + kFrameHeader) << "byte " << at << ", frame " << i;
        if (image.ok()) continue;
        EXPECT_EQ(image.status().code(), StatusCode::kIntegrity);
        EXPECT_THAT(image.status().message(), HasSubstr(id_));
        EXPECT_THAT(image.status().message(), HasSubstr("offset " + std::to_string(start)));
      }
      FlipBits(Segment(id_), at, 0x10);
    }
  }
}

TEST_F(DamageTest, ATruncationAtAnyLengthIsFound) {
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  for (size_t length = intact_.size(); length-- > 0;) {
    std::filesystem::resize_file(Segment(id_), length);
    ASSERT_THAT(Problems(store), Contains(HasSubstr("frames-0001.seg"))) << length << " bytes";
    const auto last = store.ReadFrame(id_, frames_.back());
    const size_t end = static_cast<size_t>(frames_.back().offset) + kFrameHeader + kPayload;
    ASSERT_EQ(last.ok(), length >= end) << length << " bytes";
  }
}

TEST_F(DamageTest, BytesBehindTheEndAreFound) {
  auto bytes = intact_;
  bytes.push_back(0);
  WriteBytes(Segment(id_), bytes);
  EXPECT_THAT(Problems(OpenStore(AccessMode::kReadOnly)), Contains(HasSubstr("footer")));
}

TEST_F(DamageTest, AMissingSegmentAndAMissingManifestAreNamed) {
  std::filesystem::remove(Segment(id_));
  EXPECT_THAT(Problems(OpenStore(AccessMode::kReadOnly)), Contains(HasSubstr("frames-0001.seg")));
  WriteBytes(Segment(id_), intact_);
  std::filesystem::remove(folder_ / "sessions" / id_ / "manifest.json");
  EXPECT_THAT(Problems(OpenStore(AccessMode::kReadOnly)), Contains(HasSubstr("manifest.json")));
  WriteText(folder_ / "sessions" / id_ / "manifest.json", "{\"schema\": 1");
  EXPECT_THAT(Problems(OpenStore(AccessMode::kReadOnly)), Contains(HasSubstr("manifest.json")));
}

TEST_F(DamageTest, ASegmentOfAnotherSessionIsNamed) {
  const std::string other = StoreSession(3);
  WriteBytes(Segment(id_), ReadBytes(Segment(other)));
  EXPECT_THAT(Problems(OpenStore(AccessMode::kReadOnly)), Contains(HasSubstr("belongs to session " + other)));
}

TEST_F(DamageTest, ASegmentOfANewerProgramIsNotCalledDamaged) {
  auto bytes = intact_;
  bytes[8] = 2;  // version
  WriteBytes(Segment(id_), bytes);
  const auto image = OpenStore(AccessMode::kReadOnly).ReadFrame(id_, frames_[0]);
  EXPECT_EQ(image.status().code(), StatusCode::kNewerSchema);
}

TEST_F(DamageTest, AFrameThatOnlyTheSegmentKnowsIsFound) {
  // A whole second session's segment under the first one's next number: sound bytes, unknown to the index.
  SessionStore store = OpenStore();
  const std::string id = StoreSession(4, {.group_frames = 2, .max_segment_bytes = 700});
  ASSERT_TRUE(std::filesystem::exists(Segment(id, 2)));
  std::filesystem::copy_file(Segment(id, 2), Segment(id, 3));
  const auto report = VerifySession(store, *store.FindSession(id));
  EXPECT_THAT(report->problems, Contains(HasSubstr("segments hold 6 frames, the index 4")));
}

// VerifyOf(STATUS, MADE): a session of the plan, each step with the level check that `made` gives it, if any.
class PlannedStepsTest : public StoreTest {
 protected:
  using Made = std::function<std::optional<LevelCheck>(int step)>;
  VerifyReport VerifyOf(SessionStatus status, const Made& made) {
    PlanOptions options;
    options.projectors = 1;
    plan_ = *BuildPlan(options);
    SessionStore store = OpenStore();
    SessionInfo info = SimulatedVisit();
    info.plan_json = PlanOptionsToJson(options);
    auto writer = store.BeginSession(info);
    EXPECT_TRUE(writer.ok());
    const Image<uint16_t> pixels(4, 2);
    for (const PlanStep& step : plan_.steps) {
      const auto level_check = made(step.index);
      if (!level_check) continue;
      FrameRecord record = RecordFor(step.index, PixelFormat::kMono12, 4, 2);
      record.level_check = *level_check;
      EXPECT_TRUE(writer->Append(record, pixels.view()).ok());
    }
    EXPECT_TRUE(writer->Finish(status).ok());
    return *VerifySession(store, *store.FindSession(writer->info().id));
  }
  CapturePlan plan_;
};

TEST_F(PlannedStepsTest, ACompleteSessionMustHoldEachOfThem) {
  const auto report = VerifyOf(SessionStatus::kComplete, [](int step) {
    if (step == 5) return std::optional<LevelCheck>();
    return std::optional(step == 8 ? LevelCheck::kFailed : LevelCheck::kPassed);
  });
  EXPECT_THAT(report.problems,
              Contains("2 of " + std::to_string(plan_.steps.size()) + " planned steps without a good frame: 5, 8"));
}

TEST_F(PlannedStepsTest, HundredsThatAnAbortedSessionLacksAreOneLine) {
  const auto report = VerifyOf(SessionStatus::kDegraded, [](int step) {
    return step < 2 || step == 4 ? std::optional(LevelCheck::kPassed) : std::nullopt;
  });
  const size_t steps = plan_.steps.size();
  ASSERT_GT(steps, 100U);
  EXPECT_THAT(report.problems, IsEmpty());
  EXPECT_THAT(report.notes,
              ElementsAre(std::to_string(steps - 3) + " of " + std::to_string(steps) +
                              " planned steps without a good frame: 2 to 3, 5 to " + std::to_string(steps - 1),
                          HasSubstr("the driver counted")));
}

TEST_F(PlannedStepsTest, EverySecondLackingIsOneLineStill) {
  const auto report = VerifyOf(SessionStatus::kDegraded, [](int step) {
    return step % 2 == 0 ? std::optional(LevelCheck::kPassed) : std::nullopt;
  });
  EXPECT_THAT(report.notes, ElementsAre(::testing::EndsWith("1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, ..."),
                                        HasSubstr("the driver counted")));
}

TEST_F(DamageTest, DamagedTruthIsRefused) {
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit());
  ASSERT_TRUE(writer.ok());
  const Image<float> map(8, 8, 1, 2.0F);
  ASSERT_TRUE(writer->AppendTruth("depth", map.view()).ok());
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  const auto file = store.SessionFolder(writer->info().id) / "truth.seg";
  auto bytes = ReadBytes(file);
  bytes[kFileHeader + kFrameHeader + 17] ^= 1U;
  WriteBytes(file, bytes);
  const auto truth = TruthSegment::Open(file);
  ASSERT_TRUE(truth.ok()) << "headers are intact";
  EXPECT_EQ(truth->Read("depth").status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(VerifySession(store, *store.FindSession(writer->info().id))->problems, Contains(HasSubstr("truth.seg")));
}

// As a power cut between fit.json and the row leaves it.
TEST_F(DamageTest, AFitThatTheIndexDoesNotListIsNamedAndIsNoDamage) {
  SessionStore store = OpenStore();
  const auto folder = store.FitFolder(id_, "f9");
  std::filesystem::create_directories(folder);
  WriteText(folder / "metrics.json", "{}");
  ASSERT_TRUE(store.RegisterFit({"f9", id_, "{}", "{}", {5}}).ok());
  {
    auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
    ASSERT_TRUE(connection->Execute("PRAGMA foreign_keys = ON; DELETE FROM fits").ok());
  }
  const auto report = VerifySession(store, *store.FindSession(id_));
  EXPECT_THAT(report->problems, IsEmpty());
  EXPECT_THAT(report->notes, Contains(HasSubstr("f9 is a fit that the index does not list")));
}

}  // namespace
}  // namespace stratalux::db
