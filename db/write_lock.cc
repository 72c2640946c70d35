// SPDX-License-Identifier: Apache-2.0
#include "db/write_lock.h"

#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

namespace stratalux::db {

Result<WriteLock> WriteLock::Take(const std::filesystem::path& store) {
  WriteLock lock;
  const auto file = store / "write.lock";
  lock.fd_ = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0640);
  if (lock.fd_ < 0) return Status::Failed("cannot write store " + store.string() + ": " + std::strerror(errno));
  if (flock(lock.fd_, LOCK_EX | LOCK_NB) != 0)
    return Status::Busy("store " + store.string() +
                        " is being written by another program; try again when it has finished");
  return lock;
}

WriteLock::~WriteLock() {
  if (fd_ >= 0) close(fd_);
}

}  // namespace stratalux::db
