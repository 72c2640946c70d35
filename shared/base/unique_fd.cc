// SPDX-License-Identifier: Apache-2.0
#include "shared/base/unique_fd.h"

#include <unistd.h>

namespace stratalux {

UniqueFd::~UniqueFd() {
  if (fd_ >= 0) close(fd_);
}

}  // namespace stratalux
