// SPDX-License-Identifier: Apache-2.0
#include "shared/base/standard_output.h"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string>

#include "shared/base/log.h"

namespace stratalux {

Status WriteStdout(std::string_view bytes) {
  FlushLoggers();
  if (std::fwrite(bytes.data(), 1, bytes.size(), stdout) == bytes.size() && std::fflush(stdout) == 0)
    return Status::Ok();
  return Status::Failed(std::string("cannot write the output: ") + std::strerror(errno));
}

}  // namespace stratalux
