// SPDX-License-Identifier: Apache-2.0
#include "db/base/memory_folder.h"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <random>
#include <string>

#include <fcntl.h>
#include <linux/magic.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statfs.h>
#include <unistd.h>

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kFullBytes = uint64_t{1} << 20;  // less is left: that is why a file could not be written

// "stratalux-<uid>-": whose they are.
std::string PrefixOfAccount() { return "stratalux-" + std::to_string(geteuid()) + "-"; }

// Bytes that are free there; 0 where it is no file system in memory.
uint64_t RoomOf(const fs::path& folder) {
  struct statfs facts {};
  if (statfs(folder.c_str(), &facts) != 0) return 0;
  const auto kind = static_cast<uint64_t>(facts.f_type);
  if (kind == RAMFS_MAGIC) return ~uint64_t{0};  // knows no limit, and says that nothing is free
  return kind == TMPFS_MAGIC ? uint64_t{facts.f_bavail} * static_cast<uint64_t>(facts.f_bsize) : 0;
}

UniqueFd OpenFolder(const fs::path& folder) {
  return UniqueFd(open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
}

// Whether the name still leads to the folder that is open.
bool IsNamed(const UniqueFd& open_folder, const fs::path& name) {
  struct stat held {
  }, named{};
  return fstat(open_folder.get(), &held) == 0 && lstat(name.c_str(), &named) == 0 && held.st_ino == named.st_ino &&
         held.st_dev == named.st_dev;
}

std::string Listed(const std::vector<fs::path>& roots) {
  std::string text;
  for (const fs::path& root : roots) text += (text.empty() ? "" : ", ") + root.string();
  return text;
}

}  // namespace

std::vector<fs::path> MemoryRoots() {
  std::vector<fs::path> roots = {"/dev/shm"};
  const char* runtime = std::getenv("XDG_RUNTIME_DIR");
  if (runtime != nullptr && *runtime == '/') roots.emplace_back(runtime);
  return roots;
}

void RemoveAbandonedMemory(const std::vector<fs::path>& roots) {
  for (const fs::path& root : roots) {
    std::error_code error;
    std::vector<fs::path> ours;
    for (const auto& entry : fs::directory_iterator(root, error))
      if (entry.path().filename().string().starts_with(PrefixOfAccount())) ours.push_back(entry.path());
    for (const fs::path& folder : ours) {
      const UniqueFd lock = OpenFolder(folder);
      struct stat facts {};
      // Of the name alone anybody may make one in /dev/shm.
      const bool own = lock.ok() && fstat(lock.get(), &facts) == 0 && facts.st_uid == geteuid();
      if (own && flock(lock.get(), LOCK_EX | LOCK_NB) == 0 && IsNamed(lock, folder)) fs::remove_all(folder, error);
    }
  }
}

Result<MemoryFolder> MemoryFolder::Create(const std::vector<fs::path>& roots) {
  RemoveAbandonedMemory(roots);
  std::vector<fs::path> usable;
  for (const fs::path& root : roots)
    if (RoomOf(root) > 0 && access(root.c_str(), W_OK | X_OK) == 0) usable.push_back(root);
  if (usable.empty())
    return Status::Failed(
        "no place to keep files in memory: none of " + Listed(roots) +
        " is a tmpfs or ramfs with free space that this account may write to, and decrypted files of an "
        "encrypted session are not written to a disk; mount one (mount -t tmpfs -o size=4G tmpfs "
        "/dev/shm) or name one in XDG_RUNTIME_DIR");
  const fs::path root = *std::max_element(usable.begin(), usable.end(),
                                          [](const fs::path& a, const fs::path& b) { return RoomOf(a) < RoomOf(b); });
  std::random_device random;
  while (true) {
    const fs::path folder = root / (PrefixOfAccount() + std::to_string(getpid()) + "-" +
                                    std::to_string(uint64_t{random()} << 32 | random()));
    if (mkdir(folder.c_str(), 0700) != 0)
      return Status::Failed("cannot create " + folder.string() + ": " + std::strerror(errno));
    UniqueFd lock = OpenFolder(folder);
    if (!lock.ok() && errno != ENOENT)
      return Status::Failed("cannot open " + folder.string() + ": " + std::strerror(errno));
    // Another one may have taken it for abandoned before the lock was held, and removed it.
    if (lock.ok() && flock(lock.get(), LOCK_EX) == 0 && IsNamed(lock, folder))
      return MemoryFolder(folder, std::move(lock));
  }
}

MemoryFolder::~MemoryFolder() {
  if (!lock_.ok()) return;  // moved from
  std::error_code error;
  fs::remove_all(path_, error);
}

Status MemoryFolder::Explained(const Status& failure) const {
  if (failure.ok() || RoomOf(path_) >= kFullBytes) return failure;
  const std::string root = path_.parent_path().string();
  return Status(failure.code(), failure.message() + "; the memory behind " + root +
                                    " is full; it holds the decrypted files of an encrypted session: enlarge it "
                                    "(mount -o remount,size=SIZE " +
                                    root + "), or remove what else is there");
}

}  // namespace stratalux::db
