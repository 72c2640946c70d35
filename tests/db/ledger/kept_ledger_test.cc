// SPDX-License-Identifier: Apache-2.0
#include "db/ledger/kept_ledger.h"

#include <fstream>
#include <string>

#include "tests/db/ledger/ledger_fixture.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

class KeptLedgerTest : public LedgerTest {
 protected:
  // Of this process so far, by calls that read.
  static int64_t BytesRead() {
    std::ifstream in("/proc/self/io");
    std::string name;
    int64_t bytes = 0;
    in >> name >> bytes;
    return name == "rchar:" ? bytes : -1;  // a kernel that does not count, or a container that does not tell
  }
};

TEST_F(KeptLedgerTest, AnswersAsTheLedgerDoesWhateverHappensToItsChains) {
  KeptLedger kept(store_);
  EXPECT_FALSE(*kept.IsForgotten("s1"));
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  ASSERT_TRUE(Append(store_, LedgerKind::kWithdrawal, "s2", 77).ok());
  EXPECT_TRUE(*kept.IsForgotten("s1"));
  EXPECT_EQ(*kept.WithdrawnAt("s2"), WallNs{77});
  EXPECT_FALSE(kept.WithdrawnAt("s1")->has_value());
  const fs::path other = NewStore("b");
  ASSERT_TRUE(Append(other, LedgerKind::kForgetting, "s3").ok());
  ASSERT_TRUE(MergeLedger(store_, other / "ledger").ok());
  EXPECT_TRUE(*kept.IsForgotten("s3")) << "another chain came";
  // Another file of the same size and time under the chain's name.
  const fs::path chain = ChainOf(store_), beside = root_ / "beside";
  const auto time = fs::last_write_time(chain);
  std::string text = ReadText(chain);
  text.replace(text.find("\"s1\""), 4, "\"s9\"");
  WriteText(beside, text);
  fs::last_write_time(beside, time);
  fs::rename(beside, chain);
  EXPECT_EQ(*kept.IsForgotten("s9"), ReadOf(store_).IsForgotten("s9"));
  EXPECT_EQ(*kept.IsForgotten("s1"), ReadOf(store_).IsForgotten("s1"));
  fs::remove_all(store_ / "ledger");
  EXPECT_FALSE(*kept.IsForgotten("s3"));
}

TEST_F(KeptLedgerTest, WhatCannotBeReadIsSaidEachTimeAndKeepsNoOldAnswer) {
  KeptLedger kept(store_);
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  EXPECT_TRUE(*kept.IsForgotten("s1"));
  const fs::path chain = ChainOf(store_);
  const std::string whole = ReadText(chain);
  fs::resize_file(chain, uintmax_t{2} << 30);  // longer than any chain
  for (int i = 0; i < 2; ++i) EXPECT_EQ(kept.IsForgotten("s1").status().code(), StatusCode::kFailed);
  WriteText(chain, whole);
  EXPECT_TRUE(*kept.IsForgotten("s1"));
}

TEST_F(KeptLedgerTest, AStoreOfBeforeTheLedgerIsReadEachTime) {
  KeptLedger kept(store_);
  EXPECT_FALSE(*kept.IsForgotten("s000001-0badcafe"));
  fs::create_directories(store_ / "deletions");
  WriteText(store_ / "deletions" / "s000001-0badcafe.json", "{}");
  EXPECT_TRUE(*kept.IsForgotten("s000001-0badcafe"));
  fs::remove_all(store_ / "deletions");
  EXPECT_FALSE(*kept.IsForgotten("s000001-0badcafe"));
}

TEST_F(KeptLedgerTest, IsNotReadAgainForEachQuestion) {
  std::vector<std::string> sessions;
  for (int i = 0; i < 200; ++i) sessions.push_back("s" + std::to_string(i));
  for (const std::string& session : sessions) ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, session).ok());
  const auto size = static_cast<int64_t>(fs::file_size(ChainOf(store_)));
  KeptLedger kept(store_);
  const int64_t before = BytesRead();
  if (before < 0) GTEST_SKIP() << "/proc/self/io does not tell what is read";
  for (const std::string& session : sessions) EXPECT_TRUE(*kept.IsForgotten(session));
  const int64_t read = BytesRead() - before;
  EXPECT_GE(read, size);
  EXPECT_LT(read, 3 * size) << "200 questions";
}

}  // namespace
}  // namespace stratalux::db
