// SPDX-License-Identifier: Apache-2.0
// What one store forgot, every store that it meets forgets, whichever way the chains came.
#include <gmock/gmock.h>

#include "tests/db/ledger/ledger_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class LedgerMergeTest : public LedgerTest {
 protected:
  void SetUp() override {
    LedgerTest::SetUp();
    other_ = NewStore("b");
    ASSERT_TRUE(MakeStoreId(other_).ok());
  }
  static LedgerMerge Merge(const fs::path& into, const fs::path& from) {
    auto merge = MergeLedger(into, from / "ledger");
    EXPECT_TRUE(merge.ok()) << merge.status().message();
    return merge.ok() ? *merge : LedgerMerge();
  }
  static std::map<std::string, std::vector<uint8_t>> FilesOf(const fs::path& store) {
    std::map<std::string, std::vector<uint8_t>> files;
    for (const auto& entry : fs::directory_iterator(store / "ledger"))
      files[entry.path().filename().string()] = ReadBytes(entry.path());
    return files;
  }
  fs::path other_;
};

TEST_F(LedgerMergeTest, BringsWhatIsNewAndMergingTwiceChangesNothing) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "here").ok());
  ASSERT_TRUE(Append(other_, LedgerKind::kForgetting, "s1").ok());
  ASSERT_TRUE(Append(other_, LedgerKind::kWithdrawal, "s2").ok());
  const LedgerMerge first = Merge(store_, other_);
  EXPECT_EQ(first.chains, 1);
  EXPECT_EQ(first.entries, 2);
  EXPECT_THAT(first.problems, IsEmpty());
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s1") && ReadOf(store_).IsForgotten("here"));
  EXPECT_TRUE(ReadOf(store_).WithdrawnAt("s2"));
  const auto files = FilesOf(store_);
  EXPECT_EQ(Merge(store_, other_).entries, 0);
  EXPECT_EQ(FilesOf(store_), files);
  ASSERT_TRUE(Append(other_, LedgerKind::kForgetting, "s3").ok());
  const LedgerMerge grown = Merge(store_, other_);
  EXPECT_EQ(grown.chains, 0);
  EXPECT_EQ(grown.entries, 1);
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s3"));
  EXPECT_THAT(ReadOf(store_).problems(), IsEmpty());
}

TEST_F(LedgerMergeTest, AnOlderCopyNeverShortensAChain) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  fs::copy(store_, root_ / "old", fs::copy_options::recursive);
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s2").ok());
  const auto files = FilesOf(store_);
  Merge(store_, root_ / "old");
  EXPECT_EQ(FilesOf(store_), files);
  // And the way back: an old copy of the own chain learns what it has missed.
  Merge(root_ / "old", store_);
  EXPECT_TRUE(ReadOf(root_ / "old").IsForgotten("s2"));
  ASSERT_TRUE(Append(root_ / "old", LedgerKind::kForgetting, "s3").ok());
  EXPECT_THAT(ReadOf(root_ / "old").problems(), IsEmpty());
}

// A store copied by hand, written to in both places.
TEST_F(LedgerMergeTest, AForkIsKeptBesideSaidAndBinds) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  const fs::path copy = root_ / "copy";
  fs::copy(store_, copy, fs::copy_options::recursive);
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "here").ok());
  ASSERT_TRUE(Append(copy, LedgerKind::kForgetting, "there").ok());
  const LedgerMerge forked = Merge(store_, copy);
  EXPECT_THAT(forked.problems, ElementsAre(HasSubstr("differs from what is stored here")));
  for (const char* id : {"s1", "here", "there"}) EXPECT_TRUE(ReadOf(store_).IsForgotten(id)) << id;
  EXPECT_THAT(ReadOf(store_).problems(), ElementsAre(HasSubstr("copied by hand")));
  const auto files = FilesOf(store_);
  EXPECT_THAT(files, SizeIs(4)) << "lock, store.id, chain, fork";
  Merge(store_, copy);
  EXPECT_EQ(FilesOf(store_), files) << "twice";
  // The fork grows under the same name, and each side ends with the same three entries after it has met the other.
  ASSERT_TRUE(Append(copy, LedgerKind::kForgetting, "later").ok());
  EXPECT_EQ(Merge(store_, copy).entries, 1);
  EXPECT_THAT(FilesOf(store_), SizeIs(4));
  Merge(copy, store_);
  for (const char* id : {"s1", "here", "there", "later"}) EXPECT_TRUE(ReadOf(copy).IsForgotten(id)) << id;
  const auto settled = FilesOf(copy);
  Merge(store_, copy);
  Merge(copy, store_);
  EXPECT_EQ(FilesOf(copy), settled);
  EXPECT_THAT(FilesOf(store_), SizeIs(4));
}

// A copy that lost a line departs from the chain and says nothing that is not here: it is named, and no fork is made.
TEST_F(LedgerMergeTest, ADamagedCopyThatSaysNothingNewIsNoFork) {
  for (const char* id : {"s1", "s2", "s3"}) ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, id).ok());
  const fs::path copy = root_ / "copy";
  fs::copy(store_, copy, fs::copy_options::recursive);
  const fs::path chain = ChainOf(copy);
  const std::string text = ReadFile(chain).value();
  const size_t first = text.find('\n') + 1, second = text.find('\n', first) + 1;
  WriteText(chain, text.substr(0, first) + text.substr(second));
  const auto files = FilesOf(store_);
  const LedgerMerge merge = Merge(store_, copy);
  EXPECT_EQ(merge.entries, 0);
  EXPECT_THAT(merge.problems, ElementsAre(HasSubstr("1 that do not follow"), HasSubstr("nothing of it is new")));
  EXPECT_EQ(FilesOf(store_), files);
  EXPECT_THAT(ReadOf(store_).problems(), IsEmpty());
}

TEST_F(LedgerMergeTest, ATornEndOfTheSourceIsLeftThere) {
  ASSERT_TRUE(Append(other_, LedgerKind::kForgetting, "s1").ok());
  WriteText(ChainOf(other_), ReadFile(ChainOf(other_)).value() + R"({"schema":1,"n":2,"pr)");
  EXPECT_EQ(Merge(store_, other_).entries, 1);
  EXPECT_THAT(ReadOf(store_).problems(), IsEmpty());
}

TEST_F(LedgerMergeTest, WhatIsNoChainStaysOutAndIsSaid) {
  ASSERT_TRUE(Append(other_, LedgerKind::kForgetting, "s1").ok());
  WriteText(other_ / "ledger" / (std::string(32, '1') + ".jsonl"), "random\nbytes\n");
  WriteText(other_ / "ledger" / "notes.txt", "no chain");
  WriteText(other_ / "ledger" / "s1.forgetting", "an intent is the store's own");
  const LedgerMerge merge = Merge(store_, other_);
  EXPECT_EQ(merge.chains, 1);
  EXPECT_THAT(merge.problems, ElementsAre(HasSubstr("no entry that can be read")));
  EXPECT_THAT(FilesOf(store_), SizeIs(3)) << "lock, store.id, the other's chain";
}

TEST_F(LedgerMergeTest, ADamagedSourceHidesNothingAndDestroysNothing) {
  ASSERT_TRUE(Append(other_, LedgerKind::kForgetting, "s1").ok());
  ASSERT_TRUE(Append(other_, LedgerKind::kForgetting, "s2").ok());
  Merge(store_, other_);
  FlipBits(ChainOf(other_), 20, 1);
  EXPECT_THAT(Merge(store_, other_).problems, Contains(HasSubstr("1 damaged lines")));
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s1") && ReadOf(store_).IsForgotten("s2"));
  EXPECT_EQ(LinesOf(store_ / "ledger" / ChainOf(other_).filename()).size(), 2U);
}

}  // namespace
}  // namespace stratalux::db
