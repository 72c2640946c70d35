// SPDX-License-Identifier: Apache-2.0
// incoming/: found and wiped by session and by visitor, without touching what is others'.
#include "db/care/incoming.h"

#include "db/catalogue/manifest.h"
#include "tests/db/transfer/transfer_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::IsEmpty;

class IncomingTest : public TransferTest {
 protected:
  void Lay(const std::filesystem::path& folder, const std::string& id, const std::string& visitor) const {
    std::filesystem::create_directories(folder);
    SessionInfo info;
    info.id = id;
    info.visitor = visitor;
    ASSERT_TRUE(WriteManifest(folder, info, 0, {}).ok());
  }
};

TEST_F(IncomingTest, AnEmptyStoreHasNothingToWipe) {
  EXPECT_THAT(ListIncoming(folder_), IsEmpty());
  EXPECT_THAT(*WipeIncoming(folder_, {"s1-a", "..", "", ".sources"}, {"p-1"}), IsEmpty());
}

TEST_F(IncomingTest, WipesBySessionCopyFitsAndKeptManifests) {
  Lay(IncomingFolder(folder_, "s1-a"), "s1-a", "p-1");
  Lay(IncomingFolder(folder_, "s2-b"), "s2-b", "p-2");
  Lay(IncomingFits(folder_, "s1-a") / "f1", "s1-a", "p-1");
  Lay(IncomingSources(folder_) / "x" / "sessions" / "s1-a", "s1-a", "p-1");
  EXPECT_EQ(ListIncoming(folder_).size(), 2U);
  EXPECT_EQ(WipeIncoming(folder_, {"s1-a"})->size(), 3U);
  ASSERT_EQ(ListIncoming(folder_).size(), 1U);
  EXPECT_EQ(ListIncoming(folder_)[0].id, "s2-b");
  EXPECT_THAT(*WipeIncoming(folder_, {"s1-a"}), IsEmpty());
}

TEST_F(IncomingTest, AVisitorIsFoundByTheKeptManifestWhereTheCopyHasNone) {
  std::filesystem::create_directories(IncomingFolder(folder_, "s1-a"));
  WriteText(IncomingFolder(folder_, "s1-a") / "frames-0001.seg", "a face");
  Lay(IncomingSources(folder_) / "x" / "sessions" / "s1-a", "s1-a", "p-1");
  Lay(IncomingSources(folder_) / "x" / "sessions" / "s3-c", "s3-c", "p-1");
  Lay(IncomingSources(folder_) / "x" / "sessions" / "s4-d", "s4-d", "p-2");
  EXPECT_EQ(ListIncoming(folder_)[0].visitor, "p-1");
  EXPECT_EQ(WipeIncoming(folder_, {}, {"p-1"})->size(), 3U);
  EXPECT_THAT(ListIncoming(folder_), IsEmpty());
  EXPECT_TRUE(std::filesystem::exists(IncomingSources(folder_) / "x" / "sessions" / "s4-d" / "manifest.json"));
}

TEST_F(IncomingTest, ALinkIsRemovedAndNotFollowed) {
  WriteText(far_ / "mine", "mine");
  std::filesystem::create_directories(IncomingFolder(folder_, "s1-a"));
  std::filesystem::create_symlink(far_ / "mine", IncomingFolder(folder_, "s1-a") / "link");
  ASSERT_TRUE(WipeIncoming(folder_, {"s1-a"}).ok());
  EXPECT_EQ(ReadBytes(far_ / "mine").size(), 4U);
  EXPECT_THAT(ListIncoming(folder_), IsEmpty());
}

TEST_F(IncomingTest, OneTransferAtATime) {
  auto lock = IncomingLock::Take(folder_);
  ASSERT_TRUE(lock.ok());
  EXPECT_TRUE(IncomingLock::IsHeld(folder_));
  EXPECT_EQ(IncomingLock::Take(folder_).status().code(), StatusCode::kBusy);
  lock = Status::Busy("given back");
  EXPECT_FALSE(IncomingLock::IsHeld(folder_));
}

}  // namespace
}  // namespace stratalux::db
