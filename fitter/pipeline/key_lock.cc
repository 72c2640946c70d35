// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/key_lock.h"

#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

namespace stratalux::fit {

namespace fs = std::filesystem;

// Its file is removed while it is held, so who got a lock looks whether the name still leads to the file that it has
// locked.
Result<KeyLock> KeyLock::Try(const fs::path& file) {
  UniqueFd fd(open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0640));
  if (!fd.ok()) return Status::Failed("cannot lock " + file.string() + ": " + std::strerror(errno));
  struct stat mine {
  }, named{};
  if (flock(fd.get(), LOCK_EX | LOCK_NB) != 0 || fstat(fd.get(), &mine) != 0 || lstat(file.c_str(), &named) != 0 ||
      mine.st_ino != named.st_ino || mine.st_dev != named.st_dev)
    return KeyLock();
  const std::string pid = std::to_string(getpid()) + "\n";
  static_cast<void>(!write(fd.get(), pid.data(), pid.size()));  // for people
  KeyLock lock;
  lock.fd_ = std::move(fd);
  lock.file_ = file;
  return lock;
}

KeyLock::KeyLock(KeyLock&& other) noexcept : fd_(std::move(other.fd_)), file_(std::exchange(other.file_, {})) {}

KeyLock::~KeyLock() {
  std::error_code error;
  if (!file_.empty()) fs::remove(file_, error);
}

}  // namespace stratalux::fit
