// SPDX-License-Identifier: Apache-2.0
#include "shared/base/read_file.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "shared/base/unique_fd.h"

namespace stratalux {
namespace {

const char* KindOf(mode_t mode) {
  if (S_ISDIR(mode)) return "a folder";
  if (S_ISFIFO(mode)) return "a pipe";
  if (S_ISCHR(mode) || S_ISBLK(mode)) return "a device";
  if (S_ISSOCK(mode)) return "a socket";
  return "no regular file";
}

Status TooLong(const std::string& file, int64_t bytes, int64_t most_bytes) {
  return Status::Failed("cannot read " + file + ": it has " + std::to_string(bytes) + " bytes, at most " +
                        std::to_string(most_bytes) + " are read");
}

}  // namespace

Result<std::string> ReadFile(const std::filesystem::path& file, int64_t most_bytes) {
  const auto cannot = [&file](StatusCode code) {
    return Status(code, "cannot read " + file.string() + ": " + std::strerror(errno));
  };
  if (file.native().find('\0') != std::string::npos)
    return Status::NotFound("cannot read " + file.string() + ": its name holds a zero byte");
  // Not to wait for the other end of a pipe.
  const UniqueFd fd(open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  // What is there and cannot be opened is not missing: who takes it for that makes it anew, or goes on without it.
  if (!fd.ok()) return cannot(errno == ENOENT || errno == ENOTDIR ? StatusCode::kNotFound : StatusCode::kFailed);
  struct stat facts {};
  if (fstat(fd.get(), &facts) != 0) return cannot(StatusCode::kFailed);
  if (!S_ISREG(facts.st_mode))
    return Status::Failed("cannot read " + file.string() + ": it is " + KindOf(facts.st_mode) + ", not a file");
  if (facts.st_size > most_bytes) return TooLong(file.string(), facts.st_size, most_bytes);
  std::string bytes;
  size_t filled = 0;
  // It may grow meanwhile, and files of /proc have no size.
  for (bytes.resize(static_cast<size_t>(facts.st_size) + 1);; bytes.resize(std::max<size_t>(2 * filled, 4096))) {
    while (filled < bytes.size()) {
      const ssize_t count = read(fd.get(), bytes.data() + filled, bytes.size() - filled);
      if (count < 0 && errno == EINTR) continue;
      if (count < 0) return cannot(StatusCode::kFailed);
      if (count == 0) {
        bytes.resize(filled);
        return bytes;
      }
      filled += static_cast<size_t>(count);
      if (static_cast<int64_t>(filled) > most_bytes)
        return TooLong(file.string(), static_cast<int64_t>(filled), most_bytes);
    }
  }
}

}  // namespace stratalux
