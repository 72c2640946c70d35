// SPDX-License-Identifier: Apache-2.0
#include "db/base/descriptor.h"

#include <fcntl.h>

namespace stratalux::db {

UniqueFd OpenDescriptor(const std::filesystem::path& file, int flags) {
  return UniqueFd(open(file.c_str(), flags | O_CLOEXEC, 0640));
}

}  // namespace stratalux::db
