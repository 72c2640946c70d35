// SPDX-License-Identifier: Apache-2.0
// A moment in the midst of another thread's or program's work: that in which it opens a certain file.
#pragma once

#include <csignal>
#include <ctime>
#include <filesystem>

#include <fcntl.h>

#include "shared/base/unique_fd.h"

namespace stratalux {

// A lease of the file, which must be our own and open nowhere: the kernel keeps whoever opens it waiting (45 s at most)
// until Release(). To be made before the thread that it is to keep waiting, so that none but ours takes the signal.
class HeldOpen {
 public:
  enum class Against { kReading, kWriting };  // kReading: and writing
  HeldOpen(const std::filesystem::path& file, Against against) : fd_(open(file.c_str(), O_RDONLY | O_CLOEXEC)) {
    sigemptyset(&signals_);
    sigaddset(&signals_, SIGIO);
    pthread_sigmask(SIG_BLOCK, &signals_, &before_);
    taken_ = fd_.ok() && fcntl(fd_.get(), F_SETLEASE, against == Against::kReading ? F_WRLCK : F_RDLCK) == 0;
  }
  ~HeldOpen() {
    Release();
    const timespec at_once{};
    while (sigtimedwait(&signals_, nullptr, &at_once) == SIGIO) continue;
    pthread_sigmask(SIG_SETMASK, &before_, nullptr);
  }
  HeldOpen(const HeldOpen&) = delete;
  HeldOpen& operator=(const HeldOpen&) = delete;

  // False where the file system or the kernel has no leases.
  [[nodiscard]] bool taken() const { return taken_; }
  // True once somebody waits for the file; false where nobody came within a minute.
  [[nodiscard]] bool Wait() const {
    const timespec minute{60, 0};
    return sigtimedwait(&signals_, nullptr, &minute) == SIGIO;
  }
  void Release() { fd_ = UniqueFd(); }

 private:
  UniqueFd fd_;
  sigset_t signals_{}, before_{};
  bool taken_ = false;
};

}  // namespace stratalux
