// SPDX-License-Identifier: Apache-2.0
#include "tests/db/crash/disk_model.h"

#include <cstdio>
#include <set>

#include <fcntl.h>
#include <gmock/gmock.h>

#include "tests/db/crash/crash_fixture.h"

namespace stratalux::db::crash {
namespace {

using ::testing::ElementsAre;
using ::testing::UnorderedElementsAre;

// Real calls below the store's folder, then what a power cut may leave of them.
class DiskModel : public CrashTest {
 protected:
  void SetUp() override {
    CrashTest::SetUp();
    StartRecording(Store());
  }
  void TearDown() override {
    for (const int fd : open_) close(fd);
    CrashTest::TearDown();
  }
  int Open(const std::string& name, int flags) {
    const int fd = open((Store() / name).c_str(), flags, 0600);
    EXPECT_GE(fd, 0) << name;
    open_.push_back(fd);
    return fd;
  }
  int Create(const std::string& name) { return Open(name, O_RDWR | O_CREAT); }
  void Put(int fd, const std::string& text, int64_t at) {
    ASSERT_EQ(pwrite(fd, text.data(), text.size(), at), static_cast<ssize_t>(text.size()));
  }
  void SyncNames(const std::string& folder = "") { ASSERT_EQ(fsync(Open(folder, O_RDONLY | O_DIRECTORY)), 0); }

  std::map<std::string, std::string> After(PowerCut cut, uint64_t seed = 1) {
    if (!disk_) {
      const DiskLog log = StopRecording();
      disk_.emplace(log);
      for (const DiskCall& call : log.calls) disk_->Apply(call);
    }
    std::mt19937_64 random(seed);
    std::map<std::string, std::string> files;
    for (const auto& [path, bytes] : disk_->After(cut, random)) files[path] = std::string(bytes.begin(), bytes.end());
    return files;
  }

  std::vector<int> open_;
  std::optional<Disk> disk_;
};

using File = std::pair<const std::string, std::string>;

TEST_F(DiskModel, WhatIsSyncedStaysAndTheRestMayGo) {
  const int fd = Create("a");
  Put(fd, "durable", 0);
  ASSERT_EQ(fdatasync(fd), 0);
  SyncNames();
  Put(fd, "lost", 0);
  EXPECT_THAT(After(PowerCut::kDropsAll), ElementsAre(File("a", "durable")));
  EXPECT_THAT(After(PowerCut::kKeepsAll), ElementsAre(File("a", "lostble")));
}

TEST_F(DiskModel, ASyncedFileWithoutItsNameIsGone) {
  const int fd = Create("a");
  Put(fd, "durable", 0);
  ASSERT_EQ(fsync(fd), 0);
  EXPECT_TRUE(After(PowerCut::kDropsAll).empty());
  EXPECT_TRUE(After(PowerCut::kDropsNames).empty());
  EXPECT_THAT(After(PowerCut::kDropsBytes), ElementsAre(File("a", "durable")));
}

TEST_F(DiskModel, AFolderThatWasNotSyncedTakesItsFilesAlong) {
  ASSERT_EQ(mkdir((Store() / "d").c_str(), 0700), 0);
  const int fd = Create("d/a");
  Put(fd, "x", 0);
  ASSERT_EQ(fsync(fd), 0);
  SyncNames("d");
  EXPECT_TRUE(After(PowerCut::kDropsAll).empty()) << "d itself has no name yet";
}

TEST_F(DiskModel, ARenamedFileIsTheOldOrTheNewOne) {
  for (const char* name : {"manifest", "manifest.new"}) {
    const int fd = Create(name);
    Put(fd, name, 0);
    ASSERT_EQ(fsync(fd), 0);
  }
  SyncNames();
  ASSERT_EQ(std::rename((Store() / "manifest.new").c_str(), (Store() / "manifest").c_str()), 0);
  std::set<std::string> seen;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    const auto files = After(PowerCut::kKeepsSomeBlocks, seed);
    EXPECT_EQ(files.size(), files.at("manifest") == "manifest" ? 2U : 1U);
    seen.insert(files.at("manifest"));
  }
  EXPECT_THAT(seen, UnorderedElementsAre("manifest", "manifest.new"));
}

TEST_F(DiskModel, EachBlockIsAnyOfItsVersionsAndNothingElse) {
  const int fd = Create("a");
  Put(fd, std::string(8192, 'o'), 0);
  ASSERT_EQ(fsync(fd), 0);
  SyncNames();
  Put(fd, std::string(8192, 'n'), 0);
  std::set<std::string> seen;
  for (uint64_t seed = 0; seed < 60; ++seed) {
    const std::string bytes = After(PowerCut::kKeepsSomeBlocks, seed).at("a");
    ASSERT_EQ(bytes.size(), 8192U);
    for (const size_t start : {0U, 4096U})
      EXPECT_EQ(bytes.find_first_not_of(bytes[start], start),
                start == 0 && bytes[0] != bytes[4096] ? 4096U : std::string::npos);
    seen.insert({bytes[0], bytes[4096]});
  }
  EXPECT_THAT(seen, UnorderedElementsAre("oo", "on", "no", "nn"));
}

TEST_F(DiskModel, ATornWriteHarmsNothingOutsideItsRange) {
  const int fd = Create("a");
  Put(fd, std::string(100, 'o'), 0);
  Put(fd, std::string(50, 'n'), 30);
  SyncNames();
  std::set<std::string> seen;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    const std::string bytes = After(PowerCut::kTearsLastWrite, seed).at("a");
    ASSERT_EQ(bytes.size(), 100U);
    EXPECT_EQ(bytes.substr(0, 30) + bytes.substr(80), std::string(50, 'o'));
    seen.insert(bytes);
  }
  EXPECT_GT(seen.size(), 10U);
}

TEST_F(DiskModel, BytesWhoseSyncFailedStayLostWhateverIsSyncedLater) {
  StopRecording();
  StartRecording(Store(), {DiskFault::Kind::kSyncError, 1, DiskFault::Extent::kOnce});
  const int fd = Create("a");
  SyncNames();
  Put(fd, "one", 0);
  EXPECT_EQ(fsync(fd), -1);
  Put(fd, "two", 3);
  EXPECT_EQ(fsync(fd), 0);
  EXPECT_THAT(After(PowerCut::kDropsAll), ElementsAre(File("a", std::string("\0\0\0two", 6))));
  EXPECT_THAT(After(PowerCut::kKeepsAll), ElementsAre(File("a", "onetwo"))) << "memory shows what the disk has not";
}

}  // namespace
}  // namespace stratalux::db::crash
