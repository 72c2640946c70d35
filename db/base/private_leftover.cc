// SPDX-License-Identifier: Apache-2.0
#include "db/base/private_leftover.h"

#include <cerrno>
#include <cstring>

#include <sys/stat.h>
#include <unistd.h>

namespace stratalux::db {

Result<PrivateLeftover> FindPrivateLeftover(const std::filesystem::path& file) {
  struct stat info {};
  if (lstat(file.c_str(), &info) != 0) {
    if (errno == ENOENT) return PrivateLeftover::kNone;
    return Status::Failed("cannot check " + file.string() + ": " + std::strerror(errno));
  }
  const bool ours =
      S_ISREG(info.st_mode) && info.st_uid == geteuid() && (info.st_mode & 077) == 0 && info.st_nlink == 1;
  return ours ? PrivateLeftover::kOurs : PrivateLeftover::kForeign;
}

}  // namespace stratalux::db
