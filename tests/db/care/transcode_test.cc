// SPDX-License-Identifier: Apache-2.0
// Transcoding changes how a session is stored and nothing of what it holds, wherever it is stopped.
#include "db/care/transcode.h"

#include <random>
#include <set>

#include <gmock/gmock.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/care/verify.h"
#include "db/catalogue/pixel_digest.h"
#include "db/segment/pixel_hash.h"
#include "tests/db/forged_segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::IsEmpty;

constexpr int kFrames = 6;

class TranscodeTest : public StoreTest {
 protected:
  // Frames that `delta` shrinks, in three segments.
  std::string Store(StoreCodec codec) {
    SessionStore store = OpenStore();
    auto writer = store.BeginSession(SimulatedVisit(),
                                     {.codec = codec, .max_segment_bytes = codec == StoreCodec::kRaw12 ? 5000 : 2000});
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    std::mt19937 random(5);
    for (int i = 0; i < kFrames; ++i) {
      const FrameRecord record = RecordFor(i, PixelFormat::kMono12, 50, 40);
      Image<uint16_t> pixels(50, 40);
      for (uint16_t& v : pixels.pixels()) v = static_cast<uint16_t>(100 * i + random() % 11);
      EXPECT_TRUE(writer->Append(record, std::as_const(pixels).view()).ok());
      pixels_.push_back(std::move(pixels));
    }
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    return writer->info().id;
  }
  [[nodiscard]] static Result<TranscodeReport> Transcode(const SessionStore& store, const std::string& id,
                                                         const TranscodeOptions& options) {
    Logger logger;
    Progress progress(logger, "transcode", 2 * kFrames);
    return TranscodeSession(store, *store.FindSession(id), options, progress);
  }
  void ExpectWhole(const SessionStore& store, const std::string& id) const {
    const auto frames = store.ListFrames(id);
    ASSERT_TRUE(frames.ok()) << frames.status().message();
    ASSERT_EQ(frames->size(), pixels_.size());
    int64_t bytes = 0;
    for (size_t i = 0; i < pixels_.size(); ++i) {
      const FrameRow& row = (*frames)[i];
      EXPECT_EQ(row.record.trigger_number, 1000 + static_cast<int64_t>(i));
      EXPECT_EQ(row.record.pattern.ToString(), "gray rows bit=3/10 inverse");
      const auto image = store.ReadFrame(id, row);
      ASSERT_TRUE(image.ok()) << image.status().message();
      EXPECT_TRUE(std::equal(pixels_[i].pixels().begin(), pixels_[i].pixels().end(), image->pixels().begin()));
      bytes += row.stored_bytes;
    }
    EXPECT_EQ(store.FindSession(id)->bytes, bytes);
    const auto report = VerifySession(store, *store.FindSession(id));
    ASSERT_TRUE(report.ok()) << report.status().message();
    EXPECT_THAT(report->problems, IsEmpty());
  }
  [[nodiscard]] std::set<std::string> SegmentFiles(const std::string& id) const {
    std::set<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder_ / "sessions" / id))
      if (entry.path().extension() == ".seg") names.insert(entry.path().filename().string());
    return names;
  }
  [[nodiscard]] bool HasJournal() const { return std::filesystem::exists(folder_ / "transcode.json"); }

  std::vector<Image<uint16_t>> pixels_;
};

TEST_F(TranscodeTest, KeepsPixelsAndProofsThereAndBack) {
  const std::string id = Store(StoreCodec::kRaw12);
  const SessionStore store = OpenStore();
  const auto there = Transcode(store, id, {.codec = StoreCodec::kDelta});
  ASSERT_TRUE(there.ok()) << there.status().message();
  EXPECT_EQ(there->frames, kFrames);
  EXPECT_EQ(there->changed, kFrames);
  EXPECT_EQ(there->bytes_before, kFrames * 50 * 40 * 3 / 2);
  EXPECT_LT(2 * there->bytes_after, there->bytes_before);
  ExpectWhole(store, id);
  EXPECT_THAT(*store.ListFrames(id), Each(Field(&FrameRow::codec, "delta")));
  EXPECT_THAT(SegmentFiles(id), ElementsAre("frames-0004.seg")) << "the old three are gone";
  const auto manifest = ReadBytes(folder_ / "sessions" / id / "manifest.json");
  const std::string text(manifest.begin(), manifest.end());
  EXPECT_NE(text.find("frames-0004.seg"), std::string::npos);
  EXPECT_EQ(text.find("frames-0001.seg"), std::string::npos);

  const auto back = Transcode(store, id, {.codec = StoreCodec::kRaw12, .max_segment_bytes = 5000});
  ASSERT_TRUE(back.ok()) << back.status().message();
  EXPECT_EQ(back->bytes_after, there->bytes_before);
  ExpectWhole(store, id);
  EXPECT_THAT(*store.ListFrames(id), Each(Field(&FrameRow::codec, "raw12")));
  EXPECT_EQ(SegmentFiles(id).size(), 3U);
  EXPECT_FALSE(HasJournal());
}

TEST_F(TranscodeTest, LeavesTheNameByWhichFitsKnowTheSession) {
  const std::string id = Store(StoreCodec::kRaw12);
  const SessionStore store = OpenStore();
  auto digest = [&] { return *PixelDigest(store, *store.FindSession(id), *store.ListFrames(id)); };
  auto pixel_hashes = [&] {
    std::vector<std::string> hashes;
    const auto rows = *store.ListFrames(id);
    for (const FrameRow& row : rows) hashes.push_back(row.pixel_hash);
    return hashes;
  };
  const auto before = digest();
  const auto hashes = pixel_hashes();
  ASSERT_TRUE(Transcode(store, id, {.codec = StoreCodec::kDelta}).ok());
  EXPECT_EQ(pixel_hashes(), hashes);
  EXPECT_EQ(digest(), before);
}

TEST_F(TranscodeTest, RecordsThePixelHashesThatASessionOfBeforeLacks) {
  const std::string id = Store(StoreCodec::kRaw12);
  const SessionStore store = OpenStore();
  auto digest = [&] { return *PixelDigest(store, *store.FindSession(id), *store.ListFrames(id)); };
  std::vector<std::string> hashes;
  const auto frames = *store.ListFrames(id);
  for (const FrameRow& row : frames) hashes.push_back(row.pixel_hash);
  for (int segment = 1; segment <= 3; ++segment)
    ForgeHeaders(Segment(id, segment), [](FrameHeader& h) { SetPixelHash(h, {}); });
  ASSERT_EQ((*store.ListFrames(id))[0].pixel_hash, "");
  const auto before = digest();
  ASSERT_TRUE(Transcode(store, id, {.codec = StoreCodec::kDelta}).ok());
  ExpectWhole(store, id);
  const auto rows = *store.ListFrames(id);
  for (size_t i = 0; i < rows.size(); ++i) EXPECT_EQ(rows[i].pixel_hash, hashes[i]);
  EXPECT_EQ(digest(), before) << "a fit of the session as it was is found again";
}

TEST_F(TranscodeTest, StoppedAnywhereLeavesASessionThatReadsWholeAndIsSettledAtTheNextOpening) {
  int points = 0;
  for (bool finished = false; !finished; ++points) {
    pixels_.clear();
    const std::string id = Store(StoreCodec::kRaw12);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {  // dies without a destructor at the point with number `points`
      int step = 0;
      const SessionStore store = OpenStore();
      const TranscodeOptions options{.codec = StoreCodec::kDelta, .on_step = [&](TranscodeStep) {
                                       if (step++ == points) _exit(7);
                                     }};
      _exit(Transcode(store, id, options).ok() ? 0 : 1);
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFEXITED(status));
    ASSERT_NE(WEXITSTATUS(status), 1);
    finished = WEXITSTATUS(status) == 0;
    SCOPED_TRACE("stopped at point " + std::to_string(points));
    ExpectWhole(OpenStore(AccessMode::kReadOnly), id);
    const SessionStore settled = OpenStore();
    EXPECT_FALSE(HasJournal());
    ExpectWhole(settled, id);
    std::set<std::string> indexed;
    const auto rows = settled.ListFrames(id);
    for (const FrameRow& row : *rows) indexed.insert(row.segment);
    EXPECT_EQ(SegmentFiles(id), indexed);
  }
  EXPECT_EQ(points, 1 + kFrames + 4 + 1);  // journal, frames, synced, compared, committed, settled; then the whole run
}

TEST_F(TranscodeTest, ADamagedFrameChangesNothing) {
  const std::string id = Store(StoreCodec::kRaw12);
  const auto frames = *OpenStore(AccessMode::kReadOnly).ListFrames(id);
  FlipBits(folder_ / "sessions" / id / frames[4].segment, static_cast<size_t>(frames[4].offset) + 320 + 9, 0x40);
  const auto before = SegmentFiles(id);
  const SessionStore store = OpenStore();
  EXPECT_EQ(Transcode(store, id, {.codec = StoreCodec::kDelta}).status().code(), StatusCode::kIntegrity);
  EXPECT_EQ(SegmentFiles(id), before);
  EXPECT_FALSE(HasJournal());
  const auto image = store.ReadFrame(id, frames[3]);
  ASSERT_TRUE(image.ok()) << image.status().message();
}

TEST_F(TranscodeTest, WhatDoesNotShrinkStaysInItsSegment) {
  const std::string id = StoreSession(3);  // a few pixels of noise over all bits
  const auto before = ReadBytes(Segment(id));
  const SessionStore store = OpenStore();
  const auto report = Transcode(store, id, {.codec = StoreCodec::kDelta});
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_EQ(report->changed, 0);
  EXPECT_EQ(report->bytes_after, report->bytes_before);
  EXPECT_EQ(ReadBytes(Segment(id)), before);
  EXPECT_THAT(SegmentFiles(id), ElementsAre("frames-0001.seg"));
}

TEST_F(TranscodeTest, ASessionBeingRecordedIsLeftAlone) {
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit(), {.group_frames = 1});
  ASSERT_TRUE(writer.ok());
  ASSERT_TRUE(AppendTo(*writer, 0).ok());
  EXPECT_EQ(Transcode(store, writer->info().id, {}).status().code(), StatusCode::kBusy);
  ASSERT_TRUE(AppendTo(*writer, 1).ok());
  EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
}

}  // namespace
}  // namespace stratalux::db
