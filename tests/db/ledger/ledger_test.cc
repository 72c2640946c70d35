// SPDX-License-Identifier: Apache-2.0
// What was withdrawn or forgotten stays so whatever happens to the files that say it.
#include "db/ledger/ledger.h"

#include <csignal>
#include <fstream>
#include <random>
#include <thread>

#include <gmock/gmock.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/ledger/ledger_folder.h"
#include "db/ledger/ledger_line.h"
#include "tests/db/ledger/ledger_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

TEST_F(LedgerTest, SaysWhatWasAppended) {
  ASSERT_TRUE(Append(store_, LedgerKind::kConsent, "s1").ok());
  ASSERT_TRUE(Append(store_, LedgerKind::kWithdrawal, "s1", 200).ok());
  ASSERT_TRUE(Append(store_, LedgerKind::kWithdrawal, "s1", 300).ok());
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s2").ok());
  const Ledger begun = ReadOf(store_);
  EXPECT_EQ(begun.WithdrawnAt("s1")->ns, 200) << "since the first";
  EXPECT_FALSE(begun.WithdrawnAt("s2"));
  EXPECT_TRUE(begun.IsForgotten("s2"));
  EXPECT_EQ(begun.forgotten().at("s2"), "") << "begun, not done";
  EXPECT_FALSE(begun.IsForgotten("s1"));
  ASSERT_TRUE(AppendToLedger(store_, {LedgerKind::kForgotten, {400}, {"s2"}, "", R"({"clean": true})"}).ok());
  EXPECT_EQ(ReadOf(store_).forgotten().at("s2"), R"({"clean":true})");
  EXPECT_THAT(ReadOf(store_).entries(), SizeIs(5));
  EXPECT_THAT(ReadOf(store_).problems(), IsEmpty());
}

TEST_F(LedgerTest, OfAStoreWithoutOneIsEmpty) {
  const fs::path bare = NewStore("bare");
  EXPECT_EQ(StoreId(bare).status().code(), StatusCode::kNotFound);
  EXPECT_THAT(ReadOf(bare).entries(), IsEmpty());
  EXPECT_FALSE(fs::exists(bare / "ledger")) << "reading makes nothing";
}

TEST_F(LedgerTest, KeepsItsStoreIdForEver) {
  const std::string id = *StoreId(store_);
  EXPECT_EQ(id.size(), 32U);
  ASSERT_TRUE(MakeStoreId(store_).ok());
  ASSERT_TRUE(Append(store_, LedgerKind::kConsent, "s1").ok());
  EXPECT_EQ(*StoreId(store_), id);
  const fs::path other = NewStore("other");
  ASSERT_TRUE(MakeStoreId(other).ok());
  EXPECT_NE(*StoreId(other), id);
}

// As another account's, whose mode forbids it: a loop of links stops root, too.
TEST_F(LedgerTest, AStoreIdThatCannotBeReadIsNotDrawnAnew) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  const std::string old = *StoreId(store_);
  const fs::path file = store_ / "ledger" / "store.id";
  fs::remove(file);
  fs::create_symlink(file.filename(), file);
  for (const Status& status :
       {StoreId(store_).status(), MakeStoreId(store_), Append(store_, LedgerKind::kNote, "s2")}) {
    EXPECT_EQ(status.code(), StatusCode::kFailed) << status.message();
    EXPECT_THAT(status.message(), HasSubstr(file.string()));
  }
  EXPECT_THAT(ReadOf(store_).problems(), ElementsAre(HasSubstr(file.string())));
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s1"));
  fs::remove(file);
  WriteText(file, old + "\n");
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s2").ok());
  EXPECT_EQ(*StoreId(store_), old);
  EXPECT_THAT(ReadOf(store_).problems(), IsEmpty());
}

TEST_F(LedgerTest, ADamagedStoreIdBeginsAChainBesideTheOld) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  const std::string old = *StoreId(store_);
  WriteText(store_ / "ledger" / "store.id", "nonsense\n");
  EXPECT_EQ(StoreId(store_).status().code(), StatusCode::kIntegrity);
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s1"));
  EXPECT_THAT(ReadOf(store_).problems(), ElementsAre(HasSubstr("store.id")));
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s2").ok());
  EXPECT_NE(*StoreId(store_), old);
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s1"));
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s2"));
  EXPECT_THAT(ReadOf(store_).problems(), IsEmpty());
}

// Each line names the one before by its hash: none can be taken out, moved, put in or changed unseen.
TEST_F(LedgerTest, SeesEveryLineThatIsChangedRemovedMovedOrPutIn) {
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s" + std::to_string(i)).ok());
  const auto lines = LinesOf(ChainOf(store_));
  auto problems_with = [&](const std::vector<std::string>& changed) {
    std::string text;
    for (const std::string& line : changed) text += line + "\n";
    WriteText(ChainOf(store_), text);
    return ReadOf(store_).problems();
  };
  EXPECT_THAT(problems_with(lines), IsEmpty());
  for (size_t i = 0; i + 1 < lines.size(); ++i) {
    auto removed = lines, moved = lines, twice = lines;
    removed.erase(removed.begin() + static_cast<int64_t>(i));
    std::swap(moved[i], moved[i + 1]);
    twice.insert(twice.begin() + static_cast<int64_t>(i), lines[i]);
    EXPECT_THAT(problems_with(removed), Not(IsEmpty())) << i;
    EXPECT_THAT(problems_with(moved), Not(IsEmpty())) << i;
    EXPECT_THAT(problems_with(twice), Not(IsEmpty())) << i;
  }
}

TEST_F(LedgerTest, SeesEveryBitThatFlipsAndBindsAllElse) {
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s" + std::to_string(i)).ok());
  const auto bytes = ReadBytes(ChainOf(store_));
  const auto lines = LinesOf(ChainOf(store_));
  for (size_t at = 0; at + 1 < bytes.size(); ++at) {  // the last newline alone is missing after a torn append, too
    FlipBits(ChainOf(store_), at, static_cast<uint8_t>(1U << (at % 8)));
    const Ledger ledger = ReadOf(store_);
    EXPECT_THAT(ledger.problems(), Not(IsEmpty())) << "byte " << at;
    const size_t line = at / (lines[0].size() + 1);
    for (size_t i = 0; i < lines.size(); ++i) {
      EXPECT_TRUE(i == line || ledger.IsForgotten("s" + std::to_string(i))) << "byte " << at << ", line " << i;
    }
    FlipBits(ChainOf(store_), at, static_cast<uint8_t>(1U << (at % 8)));
  }
}

TEST_F(LedgerTest, AChainUnderAnotherStoresNameIsSeenAndBinds) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  fs::rename(ChainOf(store_), store_ / "ledger" / (std::string(32, '0') + ".jsonl"));
  EXPECT_THAT(ReadOf(store_).problems(), ElementsAre(HasSubstr("does not follow")));
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s1"));
}

TEST_F(LedgerTest, CutsATornLastLineWhereverItIsTorn) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  const auto one = ReadBytes(ChainOf(store_));
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "torn").ok());
  const auto two = ReadBytes(ChainOf(store_));
  for (size_t size = one.size() + 1; size < two.size(); ++size) {
    WriteBytes(ChainOf(store_), {two.begin(), two.begin() + static_cast<int64_t>(size)});
    EXPECT_THAT(ReadOf(store_).problems(), IsEmpty()) << "a kill leaves no damage: " << size;
    ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s2").ok());
    const Ledger ledger = ReadOf(store_);
    EXPECT_THAT(ledger.problems(), IsEmpty()) << size;
    EXPECT_TRUE(ledger.IsForgotten("s1") && ledger.IsForgotten("s2")) << size;
    // Whole but for its newline: who read it may have told somebody.
    EXPECT_EQ(ledger.IsForgotten("torn"), size + 1 == two.size()) << size;
  }
}

TEST_F(LedgerTest, GoesOnBehindADamagedLastLine) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s2").ok());
  FlipBits(ChainOf(store_), fs::file_size(ChainOf(store_)) - 10, 1);
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s3").ok());
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s4").ok());
  const Ledger ledger = ReadOf(store_);
  for (const char* id : {"s1", "s2", "s3", "s4"}) EXPECT_TRUE(ledger.IsForgotten(id)) << id;
  EXPECT_THAT(ledger.problems(), ElementsAre(HasSubstr("line 2: damaged")));
}

TEST_F(LedgerTest, ALongEntryIsFoundWhole) {
  const std::string detail = "{\"text\":\"" + std::string(300000, 'x') + "\"}";
  for (int i = 0; i < 3; ++i)
    ASSERT_TRUE(AppendToLedger(store_, {LedgerKind::kForgotten, {1}, {"s" + std::to_string(i)}, "", detail}).ok());
  EXPECT_THAT(ReadOf(store_).problems(), IsEmpty());
  EXPECT_EQ(ReadOf(store_).forgotten().at("s0"), detail);
}

std::string NewerLine(const std::string& line, const std::string& from, const std::string& to) {
  std::string body = line.substr(0, line.size() - 75) + "}";
  body.replace(body.find(from), from.size(), to);
  const std::string hash = LedgerHash(body);
  body.pop_back();
  return body + ",\"hash\":\"" + hash + "\"}";
}

TEST_F(LedgerTest, OfALaterVersionIsRefused) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  const std::string line = LinesOf(ChainOf(store_))[0];
  for (const auto& [from, to] :
       {std::pair("\"schema\":1", "\"schema\":2"), std::pair("\"forgetting\"", "\"sealing\"")}) {
    WriteText(ChainOf(store_), NewerLine(line, from, to) + "\n");
    EXPECT_EQ(Ledger::Read(store_).status().code(), StatusCode::kNewerSchema) << to;
    EXPECT_EQ(Append(store_, LedgerKind::kForgetting, "s2").code(), StatusCode::kNewerSchema) << to;
  }
  // One bit of damage is no later version: the store does not close for it.
  std::string damaged = line;
  damaged.replace(damaged.find("\"schema\":1"), 10, "\"schema\":3");
  WriteText(ChainOf(store_), damaged + "\n");
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s1"));
}

TEST_F(LedgerTest, NoBytesBringItDown) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  const std::string line = LinesOf(ChainOf(store_))[0];
  const std::vector<std::string> odd = {
      "",
      "\n",
      "{}",
      "[]",
      "null",
      "1",
      R"({"schema":"1"})",
      R"({"sessions":{}})",
      std::string(100000, '['),
      std::string(5000, '\0'),
      "\xff\xfe",
      R"({"schema":1,"n":1,"prev":1,"kind":2,"at_wall_ns":"x","sessions":[1]})",
      R"({"schema":1,"n":1e300,"prev":"","kind":"forgetting","at_wall_ns":1,"sessions":["../x"],"visitor":"","detail":1})"};
  for (const std::string& text : odd) {
    WriteText(ChainOf(store_), text + "\n" + line + "\n");
    EXPECT_TRUE(ReadOf(store_).IsForgotten("s1")) << text.substr(0, 60);
    EXPECT_FALSE(ReadOf(store_).IsForgotten("../x"));
    EXPECT_TRUE(Append(store_, LedgerKind::kForgetting, "s2").ok()) << text.substr(0, 60);
    EXPECT_TRUE(ReadOf(store_).IsForgotten("s2")) << text.substr(0, 60);
  }
  std::mt19937 random(15);
  for (int round = 0; round < 200; ++round) {
    std::vector<uint8_t> bytes(random() % 2000);
    for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(random() % 8 == 0 ? '\n' : random());
    WriteBytes(ChainOf(store_), bytes);
    EXPECT_TRUE(Ledger::Read(store_).ok());
    EXPECT_TRUE(Append(store_, LedgerKind::kForgetting, "s3").ok());
    EXPECT_TRUE(ReadOf(store_).IsForgotten("s3"));
  }
}

TEST_F(LedgerTest, AnythingButAFileInAChainsPlaceIsSaidAndDoesNotHang) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  const fs::path place = store_ / "ledger" / (std::string(32, 'f') + ".jsonl");
  ASSERT_EQ(mkfifo(place.c_str(), 0600), 0);
  EXPECT_THAT(ReadOf(store_).problems(), ElementsAre(HasSubstr("not a regular file")));
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s1"));
}

// Whom it forgets would come back: nobody may go on as if it were not there.
TEST_F(LedgerTest, AChainThatCannotBeReadFailsWhoeverAsks) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  const fs::path chain = store_ / "ledger" / (std::string(32, 'f') + ".jsonl"), other = NewStore("other");
  const auto expect_refused = [&] {
    for (const Status& status : {Ledger::Read(store_).status(), Ledger::ReadFolder(store_ / "ledger").status(),
                                 ReadLedgerNews(store_, {}).status(), MergeLedger(other, store_ / "ledger").status()}) {
      EXPECT_EQ(status.code(), StatusCode::kFailed) << status.message();
      EXPECT_THAT(status.message(), HasSubstr(chain.string()));
      EXPECT_THAT(status.message(), HasSubstr("restore it from a backup"));
    }
  };
  WriteText(chain, "");
  fs::resize_file(chain, static_cast<uintmax_t>(kMostChainBytes) + 1);  // without a block of the disk
  expect_refused();
  fs::resize_file(chain, 0);
  EXPECT_TRUE(ReadOf(store_).IsForgotten("s1"));
  if (geteuid() == 0) return;  // who may read everything
  fs::permissions(chain, fs::perms::none);
  expect_refused();
}

TEST_F(LedgerTest, TakesEveryEntryOfTwoProcessesAtOnce) {
  constexpr int kEach = 100;
  std::vector<pid_t> children;
  for (const char* name : {"x", "y"}) {
    const pid_t child = fork();
    if (child == 0) {
      bool all = true;
      for (int i = 0; i < kEach; ++i) all &= Append(store_, LedgerKind::kForgetting, name + std::to_string(i)).ok();
      _exit(all ? 0 : 1);
    }
    children.push_back(child);
  }
  for (const pid_t child : children) {
    int status = 0;
    waitpid(child, &status, 0);
    EXPECT_EQ(status, 0);
  }
  const Ledger ledger = ReadOf(store_);
  EXPECT_THAT(ledger.entries(), SizeIs(2 * kEach));
  EXPECT_THAT(ledger.problems(), IsEmpty());
}

// Killed at any moment: the chain is whole, and holds what was acknowledged.
TEST_F(LedgerTest, KeepsWhatItAcknowledgedBeforeAKill) {
  for (int round = 0; round < 20; ++round) {
    int said[2];
    ASSERT_EQ(pipe(said), 0);
    const pid_t child = fork();
    if (child == 0) {
      for (int i = 0;; ++i)
        if (Append(store_, LedgerKind::kForgetting, "r" + std::to_string(round) + "-" + std::to_string(i)).ok())
          if (write(said[1], &i, sizeof i) != sizeof i) _exit(1);
    }
    close(said[1]);
    std::this_thread::sleep_for(std::chrono::milliseconds(5 + round));
    kill(child, SIGKILL);
    waitpid(child, nullptr, 0);
    const Ledger ledger = ReadOf(store_);
    EXPECT_THAT(ledger.problems(), IsEmpty());
    int acknowledged = 0;
    for (int i = 0; read(said[0], &i, sizeof i) == sizeof i; ++acknowledged)
      EXPECT_TRUE(ledger.IsForgotten("r" + std::to_string(round) + "-" + std::to_string(i)));
    close(said[0]);
  }
}

// A full disk: the entry is refused, nothing of it stays, the next one goes through.
TEST_F(LedgerTest, TakesBackWhatCouldNotBeWritten) {
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s1").ok());
  const auto before = ReadBytes(ChainOf(store_));
  const pid_t child = fork();
  if (child == 0) {
    std::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{before.size() + 20, before.size() + 20};
    setrlimit(RLIMIT_FSIZE, &limit);
    const Status refused = Append(store_, LedgerKind::kForgetting, "s2");
    _exit(refused.code() == StatusCode::kFailed && refused.message().find(".jsonl") != std::string::npos ? 0 : 1);
  }
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_EQ(status, 0);
  EXPECT_EQ(ReadBytes(ChainOf(store_)), before);
  ASSERT_TRUE(Append(store_, LedgerKind::kForgetting, "s3").ok());
  EXPECT_FALSE(ReadOf(store_).IsForgotten("s2"));
  EXPECT_THAT(ReadOf(store_).problems(), IsEmpty());
}

}  // namespace
}  // namespace stratalux::db
