// SPDX-License-Identifier: Apache-2.0
// Backup, restore and pull: what arrives is whole, what is damaged does not, what was forgotten stays away.
#include <cstdlib>

#include <gmock/gmock.h>
#include <sys/stat.h>

#include "db/care/verify.h"
#include "db/transfer/backup.h"
#include "db/transfer/pull.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

class TransferTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    std::string name = (std::filesystem::temp_directory_path() / "stratalux-far-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    far_ = name;
    backup_ = far_ / "backup";
    other_ = far_ / "other";
  }
  void TearDown() override {
    std::filesystem::remove_all(far_);
    StoreTest::TearDown();
  }
  void Forget(const std::filesystem::path& store, const std::string& id) const {
    std::filesystem::create_directories(store / "deletions");
    WriteText(store / "deletions" / (id + ".json"), R"({"session":")" + id + "\"}");
  }
  static std::vector<std::string> Ids(const std::filesystem::path& store) {
    std::vector<std::string> ids;
    const auto open = SessionStore::Open(store, AccessMode::kReadOnly);
    EXPECT_TRUE(open.ok()) << open.status().message();
    if (!open.ok()) return ids;
    const auto rows = open->ListSessions();
    EXPECT_TRUE(rows.ok()) << rows.status().message();
    for (const auto& row : *rows) {
      ids.push_back(row.info.id);
      EXPECT_THAT(VerifySession(*open, row)->problems, IsEmpty()) << row.info.id;
    }
    return ids;
  }

  std::filesystem::path far_, backup_, other_;
  Logger logger_{LogLevel::kError};
};

TEST_F(TransferTest, ABackupMadeWhileASessionIsWrittenRestoresEveryFinishedOne) {
  const std::string first = StoreSession(3), second = StoreSession(2);
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit());
  ASSERT_TRUE(AppendTo(*writer, 0).ok());
  const auto made = Backup(folder_, {backup_, {}}, logger_);
  ASSERT_TRUE(made.ok()) << made.status().message();
  EXPECT_EQ(made->sessions, 2);
  EXPECT_THAT(made->left_out, SizeIs(1));
  const auto restored = Restore(backup_, other_, RestoreInto::kNewStore, logger_);
  ASSERT_TRUE(restored.ok()) << restored.status().message();
  EXPECT_EQ(Ids(other_), (std::vector{second, first}));
  EXPECT_EQ(Restore(backup_, other_, RestoreInto::kNewStore, logger_).status().code(), StatusCode::kUsage);
}

TEST_F(TransferTest, ASecondBackupCopiesOnlyWhatIsNewAndDropsWhatWasForgotten) {
  const std::string first = StoreSession(3);
  ASSERT_TRUE(Backup(folder_, {backup_, {}}, logger_).ok());
  const std::string second = StoreSession(2);
  auto again = Backup(folder_, {backup_, {}}, logger_);
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(again->files_kept, 2) << "manifest and segment of the first";
  EXPECT_EQ(again->files_copied, 2);
  Forget(folder_, first);
  again = Backup(folder_, {backup_, {}}, logger_);
  ASSERT_TRUE(again.ok());
  EXPECT_EQ(again->files_removed, 2);
  EXPECT_FALSE(std::filesystem::exists(backup_ / "sessions" / first));
  const auto restored = Restore(backup_, other_, RestoreInto::kNewStore, logger_);
  EXPECT_EQ(Ids(other_), std::vector{second});
}

TEST_F(TransferTest, KeysAreNeverInABackup) {
  StoreSession(1);
  { ASSERT_TRUE(SessionStore::Create(far_ / "k").ok()); }
  std::filesystem::copy_file(far_ / "k" / "index.sqlite", folder_ / "keys.sqlite");
  EXPECT_EQ(Backup(folder_, {backup_, backup_ / "keys"}, logger_).status().code(), StatusCode::kUsage);
  ASSERT_TRUE(Backup(folder_, {backup_, far_ / "keys.copy"}, logger_).ok());
  EXPECT_TRUE(std::filesystem::exists(far_ / "keys.copy"));
  for (const auto& entry : std::filesystem::recursive_directory_iterator(backup_))
    EXPECT_THAT(entry.path().string(), Not(HasSubstr("keys")));
}

TEST_F(TransferTest, ADamagedByteAnywhereInABackupIsNotRestored) {
  const std::string id = StoreSession(2);
  ASSERT_TRUE(Backup(folder_, {backup_, {}}, logger_).ok());
  const auto segment = backup_ / "sessions" / id / "frames-0001.seg";
  for (const auto& file : {segment, backup_ / "sessions" / id / "manifest.json", backup_ / "index.sqlite"}) {
    const auto size = std::filesystem::file_size(file);
    for (size_t at = 0; at < size; at += size / 7 + 1) {
      FlipBits(file, at, 4);
      EXPECT_EQ(Restore(backup_, other_, RestoreInto::kNewStore, logger_).status().code(), StatusCode::kIntegrity)
          << file << " " << at;
      EXPECT_FALSE(std::filesystem::exists(other_ / "index.sqlite"));
      FlipBits(file, at, 4);
    }
  }
  EXPECT_TRUE(Restore(backup_, other_, RestoreInto::kNewStore, logger_).ok()) << "the interrupted restore goes on";
  EXPECT_EQ(Ids(other_), std::vector{id});
}

TEST_F(TransferTest, ADamagedSegmentDoesNotReplaceItsGoodCopy) {
  const std::string id = StoreSession(2);
  ASSERT_TRUE(Backup(folder_, {backup_, {}}, logger_).ok());
  const auto good = ReadBytes(backup_ / "sessions" / id / "frames-0001.seg");
  FlipBits(Segment(id), 64 + 320 + 3, 1);
  EXPECT_EQ(Backup(folder_, {backup_, {}}, logger_).status().code(), StatusCode::kIntegrity);
  EXPECT_EQ(ReadBytes(backup_ / "sessions" / id / "frames-0001.seg"), good);
}

TEST_F(TransferTest, MergingKeepsWhatIsThereAndObeysTombstonesOfBothSides) {
  const std::string first = StoreSession(1), second = StoreSession(2), third = StoreSession(3);
  ASSERT_TRUE(Backup(folder_, {backup_, {}}, logger_).ok());
  ASSERT_TRUE(SessionStore::Create(other_).ok());
  Forget(other_, second);
  const auto merged = Restore(backup_, other_, RestoreInto::kMerge, logger_);
  ASSERT_TRUE(merged.ok()) << merged.status().message();
  EXPECT_EQ(merged->sessions, 2);
  EXPECT_EQ(merged->forgotten, 1);
  EXPECT_EQ(Ids(other_), (std::vector{third, first}));
  EXPECT_EQ(Restore(backup_, other_, RestoreInto::kMerge, logger_)->present, 2);
}

TEST_F(TransferTest, PullTakesFinishedSessionsInTheirOrderAndOnce) {
  const std::string first = StoreSession(1), second = StoreSession(2);
  {
    SessionStore store = OpenStore();
    ASSERT_TRUE(store.BeginSession(SimulatedVisit()).ok());  // dropped: unfinished
  }
  ASSERT_TRUE(SessionStore::Create(other_).ok());
  EXPECT_THAT(Pull(other_, folder_.string(), PullMode::kDryRun, logger_)->sessions, SizeIs(2));
  EXPECT_THAT(Ids(other_), IsEmpty());
  const auto pulled = Pull(other_, folder_.string() + "/", PullMode::kCopy, logger_);
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_EQ(pulled->unfinished, 1);
  EXPECT_EQ(Ids(other_), (std::vector{second, first}));
  EXPECT_EQ(Pull(other_, folder_.string(), PullMode::kCopy, logger_)->present, 2);
}

TEST_F(TransferTest, APullThatWasCutGoesOnAndADamagedSessionNeverBecomesVisible) {
  const std::string id = StoreSession(4);
  ASSERT_TRUE(SessionStore::Create(other_).ok());
  std::filesystem::create_directories(other_ / "incoming" / id);  // as a cut rsync leaves it
  std::filesystem::copy_file(Segment(id), other_ / "incoming" / id / "frames-0001.seg");
  std::filesystem::resize_file(other_ / "incoming" / id / "frames-0001.seg", 500);
  FlipBits(Segment(id), 64 + 320 + 3, 1);
  const auto damaged = Pull(other_, folder_.string(), PullMode::kCopy, logger_);
  ASSERT_TRUE(damaged.ok()) << damaged.status().message();
  EXPECT_THAT(damaged->problems, ElementsAre(HasSubstr("does not match its hash")));
  EXPECT_THAT(Ids(other_), IsEmpty());
  EXPECT_FALSE(std::filesystem::exists(other_ / "sessions" / id));
  FlipBits(Segment(id), 64 + 320 + 3, 1);
  std::filesystem::last_write_time(Segment(id), std::filesystem::file_time_type::clock::now());
  ASSERT_TRUE(Pull(other_, folder_.string(), PullMode::kCopy, logger_).ok());
  EXPECT_EQ(Ids(other_), std::vector{id});
}

TEST_F(TransferTest, PullObeysTombstonesOfBothSides) {
  const std::string first = StoreSession(1), second = StoreSession(1), third = StoreSession(1);
  ASSERT_TRUE(SessionStore::Create(other_).ok());
  Forget(folder_, first);
  Forget(other_, second);
  const auto pulled = Pull(other_, folder_.string(), PullMode::kCopy, logger_);
  EXPECT_EQ(pulled->forgotten, 2);
  EXPECT_EQ(Ids(other_), std::vector{third});
  Forget(folder_, third);
  EXPECT_THAT(Pull(other_, folder_.string(), PullMode::kCopy, logger_)->problems,
              ElementsAre(HasSubstr("forget " + third)));
}

TEST_F(TransferTest, PullSpeaksSshAndSaysWhatIsMissing) {
  const std::string id = StoreSession(2);
  ASSERT_TRUE(SessionStore::Create(other_).ok());
  std::filesystem::create_directories(far_ / "bin");
  // ssh HOST COMMAND...: runs here what the other side would run.
  WriteText(far_ / "bin" / "ssh", "#!/bin/sh\nwhile [ \"$1\" != rsync ]; do shift; done\nexec \"$@\"\n");
  ASSERT_EQ(chmod((far_ / "bin" / "ssh").c_str(), 0755), 0);
  const std::string path = std::getenv("PATH");
  setenv("PATH", ((far_ / "bin").string() + ":" + path).c_str(), 1);
  const auto pulled = Pull(other_, "kiosk@rig:" + folder_.string(), PullMode::kCopy, logger_);
  setenv("PATH", (far_ / "bin").c_str(), 1);
  const auto without = Pull(other_, folder_.string(), PullMode::kCopy, logger_);
  setenv("PATH", path.c_str(), 1);
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_EQ(Ids(other_), std::vector{id});
  EXPECT_EQ(without.status().code(), StatusCode::kNotFound);
  EXPECT_THAT(without.status().message(), HasSubstr("apt-get install rsync"));
}

}  // namespace
}  // namespace stratalux::db
