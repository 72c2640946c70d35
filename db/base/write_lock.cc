// SPDX-License-Identifier: Apache-2.0
#include "db/base/write_lock.h"

#include <cerrno>
#include <chrono>
#include <cstring>
#include <thread>
#include <utility>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

namespace stratalux::db {

Result<WriteLock> WriteLock::TryTake(const std::filesystem::path& store) {
  WriteLock lock;
  lock.fd_ = open((store / "write.lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0640);
  if (lock.fd_ < 0) return Status::Failed("cannot write store " + store.string() + ": " + std::strerror(errno));
  if (flock(lock.fd_, LOCK_EX | LOCK_NB) == 0) return lock;
  if (errno != EWOULDBLOCK) return Status::Failed("cannot lock store " + store.string() + ": " + std::strerror(errno));
  return Status::Busy("store " + store.string() +
                      " is being written by another program; try again when it has finished");
}

Result<WriteLock> WriteLock::Take(const std::filesystem::path& store) {
  using namespace std::chrono_literals;
  const auto deadline = std::chrono::steady_clock::now() + 500ms;
  while (true) {
    auto lock = TryTake(store);
    if (lock.status().code() != StatusCode::kBusy || std::chrono::steady_clock::now() > deadline) return lock;
    std::this_thread::sleep_for(10ms);
  }
}

bool WriteLock::IsHeld(const std::filesystem::path& store) {
  const int fd = open((store / "write.lock").c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) return false;
  const bool held = flock(fd, LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
  close(fd);
  return held;
}

WriteLock::~WriteLock() {
  if (fd_ >= 0) close(fd_);
}
WriteLock::WriteLock(WriteLock&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
WriteLock& WriteLock::operator=(WriteLock&& other) noexcept {
  std::swap(fd_, other.fd_);
  return *this;
}

}  // namespace stratalux::db
