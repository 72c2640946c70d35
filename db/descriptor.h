// SPDX-License-Identifier: Apache-2.0
// A file descriptor that is closed when it goes. Internal to db/.
#pragma once

#include <filesystem>

namespace stratalux::db {

class Descriptor {
 public:
  // `flags` of open(2). get() < 0, with errno, where the file cannot be opened.
  Descriptor(const std::filesystem::path& file, int flags);
  ~Descriptor();
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  [[nodiscard]] int get() const { return fd_; }

 private:
  int fd_;
};

}  // namespace stratalux::db
