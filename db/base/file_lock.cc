// SPDX-License-Identifier: Apache-2.0
#include "db/base/file_lock.h"

#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/file.h>

#include "db/base/descriptor.h"

namespace stratalux::db {

Result<FileLock> FileLock::TryTake(const std::filesystem::path& file, const std::string& busy) {
  FileLock lock;
  lock.fd_ = OpenDescriptor(file, O_RDWR | O_CREAT);
  if (!lock.fd_.ok()) return Status::Failed("cannot write " + file.string() + ": " + std::strerror(errno));
  if (flock(lock.fd_.get(), LOCK_EX | LOCK_NB) == 0) return lock;
  if (errno != EWOULDBLOCK) return Status::Failed("cannot lock " + file.string() + ": " + std::strerror(errno));
  return Status::Busy(busy);
}

bool FileLock::IsHeld(const std::filesystem::path& file) {
  const UniqueFd fd = OpenDescriptor(file, O_RDONLY);
  return fd.ok() && flock(fd.get(), LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
}

}  // namespace stratalux::db
