// SPDX-License-Identifier: Apache-2.0
// A store of before the ledger: what it forgot is taken over, whole, once, wherever the power fails.
#include "db/ledger/old_tombstones.h"

#include <gmock/gmock.h>

#include "tests/db/ledger/ledger_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class OldTombstonesTest : public LedgerTest {
 protected:
  void SetUp() override {
    store_ = NewStore("old");
    FillDeletions();
  }
  void FillDeletions() const {
    fs::create_directories(store_ / "deletions");
    WriteText(store_ / "deletions" / "s000001-a.json",
              R"({"schema": 1, "session": "s000001-a", "reason": "purge", "deleted_wall_ns": 77})");
    WriteText(store_ / "deletions" / "s000002-b.json", "no JSON");
    WriteText(store_ / "deletions" / "s000003-c.forgetting", R"({"session": "s000003-c", "reason": 5})");
    WriteText(store_ / "deletions" / "s000004-d.forgetting.wiping", "v-visitor");
    WriteText(store_ / "deletions" / "s000005-e.json.new", "v-visitor");
  }
  static void ExpectBinding(const Ledger& ledger) {
    for (const char* id : {"s000001-a", "s000002-b", "s000003-c"}) EXPECT_TRUE(ledger.IsForgotten(id)) << id;
    EXPECT_FALSE(ledger.IsForgotten("s000004-d") || ledger.IsForgotten("s000005-e"));
    EXPECT_EQ(ledger.forgotten().at("s000001-a"),
              R"({"schema":1,"session":"s000001-a","reason":"purge","deleted_wall_ns":77})");
    EXPECT_NE(ledger.forgotten().at("s000002-b"), "") << "done, whatever its certificate said";
    EXPECT_EQ(ledger.forgotten().at("s000003-c"), "") << "begun";
    EXPECT_THAT(ledger.entries(), SizeIs(3));
    EXPECT_THAT(ledger.problems(), IsEmpty());
  }
};

TEST_F(OldTombstonesTest, BindBeforeTheyAreTakenOver) { ExpectBinding(ReadOf(store_)); }

TEST_F(OldTombstonesTest, BecomeEntriesAndTheFolderGoes) {
  ASSERT_TRUE(TakeOverOldTombstones(store_).ok());
  ExpectBinding(ReadOf(store_));
  EXPECT_FALSE(fs::exists(store_ / "deletions"));
  EXPECT_TRUE(fs::exists(store_ / "ledger" / "s000003-c.forgetting")) << "for `forget --resume`";
  const auto chain = ReadBytes(ChainOf(store_));
  ASSERT_TRUE(TakeOverOldTombstones(store_).ok());
  EXPECT_EQ(ReadBytes(ChainOf(store_)), chain);
}

TEST_F(OldTombstonesTest, AreTakenOverOnceHoweverOftenItBreaksOff) {
  ASSERT_TRUE(TakeOverOldTombstones(store_).ok());
  const auto chain = ReadBytes(ChainOf(store_));
  // Broken off behind the entries, with any of the files still there.
  for (const char* left : {"s000001-a.json", "s000002-b.json", "s000004-d.forgetting.wiping"}) {
    FillDeletions();
    for (const auto& entry : fs::directory_iterator(store_ / "deletions"))
      if (entry.path().filename() != left) fs::remove(entry.path());
    ASSERT_TRUE(TakeOverOldTombstones(store_).ok()) << left;
    EXPECT_EQ(ReadBytes(ChainOf(store_)), chain) << left;
    EXPECT_FALSE(fs::exists(store_ / "deletions")) << left;
  }
}

TEST_F(OldTombstonesTest, AFileOfSomebodyElseStays) {
  WriteText(store_ / "deletions" / "letter.txt", "from a visitor");
  ASSERT_TRUE(TakeOverOldTombstones(store_).ok());
  ExpectBinding(ReadOf(store_));
  EXPECT_TRUE(fs::exists(store_ / "deletions" / "letter.txt"));
}

// Nobody knows whom it forgot: as a chain that cannot be read.
TEST_F(OldTombstonesTest, AFolderThatCannotBeListedFailsWhoeverAsks) {
  fs::rename(store_ / "deletions", store_ / "aside");
  WriteText(store_ / "deletions", "no folder, which not even root can list");
  const auto ledger = Ledger::Read(store_);
  EXPECT_EQ(ledger.status().code(), StatusCode::kFailed);
  EXPECT_THAT(ledger.status().message(), ::testing::HasSubstr("cannot list " + (store_ / "deletions").string()));
  fs::remove(store_ / "deletions");
  fs::rename(store_ / "aside", store_ / "deletions");
  ExpectBinding(ReadOf(store_));
}

}  // namespace
}  // namespace stratalux::db
