// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/bytes_below.h"

#include <system_error>

#include <sys/stat.h>

namespace stratalux::fit {

int64_t BytesBelow(const std::filesystem::path& folder, SeenFiles& seen) {
  int64_t bytes = 0;
  std::error_code error;
  for (std::filesystem::recursive_directory_iterator at(folder, error), end; !error && at != end; at.increment(error)) {
    struct stat file {};
    if (lstat(at->path().c_str(), &file) != 0 || !S_ISREG(file.st_mode)) continue;
    if (seen.emplace(file.st_dev, file.st_ino).second) bytes += file.st_size;
  }
  return bytes;
}

}  // namespace stratalux::fit
