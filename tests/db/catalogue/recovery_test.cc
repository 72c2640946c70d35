// SPDX-License-Identifier: Apache-2.0
// How sessions end whose writer is gone; that no power cut disturbs it is shown in tests/db/crash.
#include "db/catalogue/recovery.h"

#include <gmock/gmock.h>

#include "db/base/sqlite.h"
#include "db/care/verify.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

SessionInfo Simulated() {
  SessionInfo info;
  info.simulated = true;
  return info;
}

class RecoveryTest : public StoreTest {
 protected:
  // Five frames, four of them acknowledged; the writer goes without a word.
  std::string Abandon(const WriterOptions& options = Groups(2)) {
    SessionStore store = OpenStore();
    auto writer = store.BeginSession(Simulated(), options);
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < 5; ++i) EXPECT_TRUE(AppendTo(*writer, i).ok());
    return writer->info().id;
  }
};

TEST_F(RecoveryTest, TheFootersOfSealedSegmentsStay) {
  WriterOptions options = Groups(2);
  options.max_segment_bytes = 700;  // two frames
  const std::string id = Abandon(options);
  const auto sealed = ReadBytes(Segment(id, 1));
  const SessionStore store = OpenStore();
  EXPECT_EQ(ReadBytes(Segment(id, 1)), sealed);
  EXPECT_FALSE(std::filesystem::exists(Segment(id, 3))) << "none of its frames was acknowledged";
  EXPECT_EQ(store.ListFrames(id)->size(), 4U);
  EXPECT_THAT(VerifySession(store, *store.FindSession(id))->problems, IsEmpty());
}

TEST_F(RecoveryTest, ASealedSegmentThatAnOlderIndexDoesNotKnowIsKept) {
  // As after an index.sqlite from last week's copy.
  const std::string id = StoreSession(3);
  std::filesystem::remove(folder_ / "sessions" / id / "manifest.json");
  ASSERT_TRUE(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)
                  ->Execute("DELETE FROM proofs; DELETE FROM frames; UPDATE sessions SET status = 'recording',"
                            " frame_count = 0, stored_bytes = 0")
                  .ok());
  const auto before = ReadBytes(Segment(id));
  const SessionStore store = OpenStore();
  EXPECT_EQ(ReadBytes(Segment(id)), before);
  EXPECT_THAT(store.notes(), Contains(AllOf(HasSubstr(id), HasSubstr("frames that the index does not know"))));
}

TEST_F(RecoveryTest, WhatIsMissingIsSaidAndTheSessionStillEnds) {
  const std::string id = Abandon();
  std::filesystem::resize_file(Segment(id), 700);
  {
    const SessionStore store = OpenStore();
    EXPECT_THAT(store.notes(), Contains(AllOf(HasSubstr(id), HasSubstr("frames-0001.seg lacks the last"))));
    EXPECT_EQ(store.FindSession(id)->info.status, SessionStatus::kFailed);
  }
  const std::string other = Abandon();
  std::filesystem::remove(Segment(other));
  const SessionStore store = OpenStore();
  EXPECT_THAT(store.notes(), Contains(AllOf(HasSubstr(other), HasSubstr("frames-0001.seg is missing"))));
  EXPECT_EQ(store.FindSession(other)->info.status, SessionStatus::kFailed);
}

TEST_F(RecoveryTest, AManifestEndsASessionWhoseLastRowWasNotWritten) {
  const std::string id = StoreSession(3);
  ASSERT_TRUE(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)
                  ->Execute("UPDATE sessions SET status = 'recording', finished_wall_ns = NULL")
                  .ok());
  const auto before = ReadBytes(Segment(id));
  const SessionStore store = OpenStore();
  EXPECT_THAT(store.notes(), ::testing::ElementsAre(AllOf(HasSubstr(id), HasSubstr("complete"))));
  EXPECT_EQ(store.FindSession(id)->info.status, SessionStatus::kComplete);
  EXPECT_EQ(ReadBytes(Segment(id)), before);
}

TEST_F(RecoveryTest, RecoveryCutsNothingThroughASymbolicLink) {
  std::string id;
  {
    SessionStore store = OpenStore();
    auto writer = store.BeginSession(Simulated(), Groups(2));
    id = writer->info().id;
    for (int i = 0; i < 3; ++i) ASSERT_TRUE(AppendTo(*writer, i).ok());
  }
  const auto elsewhere = folder_ / "elsewhere.seg";
  std::filesystem::rename(Segment(id), elsewhere);
  std::filesystem::create_symlink(elsewhere, Segment(id));
  const auto before = ReadBytes(elsewhere);
  const SessionStore store = OpenStore();
  EXPECT_THAT(store.notes(), ::testing::Contains(HasSubstr("frames-0001.seg is not a regular file")));
  EXPECT_EQ(ReadBytes(elsewhere), before);
  EXPECT_EQ(store.ListFrames(id)->size(), 2U) << "reading through it is no harm";
}

}  // namespace
}  // namespace stratalux::db
