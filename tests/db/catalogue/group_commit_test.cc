// SPDX-License-Identifier: Apache-2.0
// Frames are acknowledged by number or by time, whichever comes first; the time is a clock the test moves.
#include <gtest/gtest.h>

#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using std::chrono::milliseconds;

class GroupCommit : public StoreTest {
 protected:
  Result<SessionWriter> Begin(SessionStore& store, int group_frames) {
    return store.BeginSession(SimulatedVisit(), {.group_frames = group_frames, .now = [this] { return now_; }});
  }
  std::chrono::steady_clock::time_point now_{milliseconds(1'000'000)};
};

TEST_F(GroupCommit, ComesWithTheLastFrameOfAGroup) {
  SessionStore store = OpenStore();
  auto writer = Begin(store, 8);
  ASSERT_TRUE(writer.ok());
  for (int i = 1; i <= 20; ++i) {
    ASSERT_TRUE(AppendTo(*writer, i).ok());
    EXPECT_EQ(writer->acknowledged_frames(), i / 8 * 8) << i;
  }
}

TEST_F(GroupCommit, ComesWhenTheFirstFrameOfAGroupHasWaited250Milliseconds) {
  SessionStore store = OpenStore();
  auto writer = Begin(store, 32);
  ASSERT_TRUE(writer.ok());
  for (int i = 0; i < 3; ++i, now_ += milliseconds(100)) ASSERT_TRUE(AppendTo(*writer, i).ok());
  EXPECT_EQ(writer->acknowledged_frames(), 0) << "200 ms";
  ASSERT_TRUE(AppendTo(*writer, 3).ok());
  EXPECT_EQ(writer->acknowledged_frames(), 4) << "300 ms";
  now_ += milliseconds(10'000);  // with nothing pending no time runs
  ASSERT_TRUE(AppendTo(*writer, 4).ok());
  EXPECT_EQ(writer->acknowledged_frames(), 4);
}

TEST_F(GroupCommit, ComesWithoutAFurtherFrameWhenAskedInTime) {
  SessionStore store = OpenStore();
  auto writer = Begin(store, 32);
  ASSERT_TRUE(writer.ok());
  ASSERT_TRUE(writer->FlushIfDue().ok());
  ASSERT_TRUE(AppendTo(*writer, 0).ok());
  now_ += milliseconds(249);
  ASSERT_TRUE(writer->FlushIfDue().ok());
  EXPECT_EQ(writer->acknowledged_frames(), 0);
  now_ += milliseconds(1);
  ASSERT_TRUE(writer->FlushIfDue().ok());
  EXPECT_EQ(writer->acknowledged_frames(), 1);
  EXPECT_EQ(OpenStore(AccessMode::kReadOnly).ListFrames(writer->info().id)->size(), 1U);
}

}  // namespace
}  // namespace stratalux::db
