// SPDX-License-Identifier: Apache-2.0
// Files in memory: on no disk, nobody else's, and gone with their process, at the latest when the next one looks.
#include "db/base/memory_folder.h"

#include <csignal>
#include <cstring>
#include <string>

#include <gmock/gmock.h>
#include <linux/magic.h>
#include <sys/stat.h>
#include <sys/statfs.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// A process that makes a folder with a file in it, says its name and waits for its end.
class Other {
 public:
  Other() {
    int ends[2];
    if (pipe(ends) != 0) throw std::runtime_error("pipe");
    pid_ = fork();
    if (pid_ == 0) {
      const auto folder = MemoryFolder::Create();
      if (!folder.ok()) _exit(1);
      WriteText(folder->path() / "map.exr", "a face");
      const std::string name = folder->path().string() + "\n";
      if (write(ends[1], name.data(), name.size()) < 0) _exit(1);
      while (true) pause();
    }
    close(ends[1]);
    for (char c = 0; read(ends[0], &c, 1) == 1 && c != '\n';) name_ += c;
    close(ends[0]);
  }
  ~Other() { Kill(); }
  void Kill() {
    if (pid_ <= 0) return;
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
    pid_ = -1;
  }
  [[nodiscard]] fs::path folder() const { return name_; }

 private:
  pid_t pid_ = -1;
  std::string name_;
};

TEST(MemoryFolder, IsOfThisAccountAloneAndOfNoDisk) {
  fs::path path;
  {
    const auto folder = MemoryFolder::Create();
    ASSERT_TRUE(folder.ok()) << folder.status().message();
    path = folder->path();
    struct stat facts {};
    ASSERT_EQ(stat(path.c_str(), &facts), 0);
    EXPECT_EQ(facts.st_mode & 0777U, 0700U);
    EXPECT_EQ(facts.st_uid, geteuid());
    struct statfs system {};
    ASSERT_EQ(statfs(path.c_str(), &system), 0);
    EXPECT_TRUE(system.f_type == TMPFS_MAGIC || system.f_type == RAMFS_MAGIC);
    WriteText(path / "map.exr", "a face");
  }
  EXPECT_FALSE(fs::exists(path));
}

// What may not go to a disk goes nowhere.
TEST(MemoryFolder, IsRefusedWhereThereIsNoMemory) {
  const auto folder = MemoryFolder::Create({"/proc", "/nonexistent"});
  EXPECT_EQ(folder.status().code(), StatusCode::kFailed);
  for (const char* part : {"/proc, /nonexistent", "mount -t tmpfs", "XDG_RUNTIME_DIR"})
    EXPECT_THAT(folder.status().message(), HasSubstr(part));
}

TEST(MemoryFolder, OfAKilledProcessGoesAndOfALivingOneStays) {
  Other killed, living;
  ASSERT_TRUE(fs::exists(killed.folder() / "map.exr"));
  ASSERT_TRUE(fs::exists(living.folder() / "map.exr"));
  {
    const auto mine = MemoryFolder::Create();
    EXPECT_TRUE(fs::exists(killed.folder() / "map.exr")) << "it lives";
  }
  killed.Kill();
  ASSERT_TRUE(fs::exists(killed.folder() / "map.exr")) << "nobody has looked yet";
  const auto next = MemoryFolder::Create();
  EXPECT_FALSE(fs::exists(killed.folder()));
  EXPECT_TRUE(fs::exists(living.folder() / "map.exr"));
}

class NamesOfOthers : public ScratchFolderTest {};

// In /dev/shm anybody may make any name.
TEST_F(NamesOfOthers, LeadNowhere) {
  const fs::path link = folder_ / ("stratalux-" + std::to_string(geteuid()) + "-1-1"), target = folder_ / "mine";
  fs::create_directory(target);
  WriteText(target / "keep", "me");
  fs::create_directory_symlink(target, link);
  RemoveAbandonedMemory({folder_});
  EXPECT_EQ(ReadText(target / "keep"), "me");
  EXPECT_TRUE(fs::is_symlink(link));
}

}  // namespace
}  // namespace stratalux::db
