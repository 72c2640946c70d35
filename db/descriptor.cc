// SPDX-License-Identifier: Apache-2.0
#include "db/descriptor.h"

#include <fcntl.h>
#include <unistd.h>

namespace stratalux::db {

Descriptor::Descriptor(const std::filesystem::path& file, int flags)
    : fd_(open(file.c_str(), flags | O_CLOEXEC, 0640)) {}

Descriptor::~Descriptor() {
  if (fd_ >= 0) close(fd_);
}

}  // namespace stratalux::db
