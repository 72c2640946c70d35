// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/durable_file.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string_view>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

namespace stratalux::db {
namespace {

class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  [[nodiscard]] int get() const { return fd_; }
  [[nodiscard]] bool ok() const { return fd_ >= 0; }

 private:
  int fd_;
};

bool WriteAll(int fd, std::string_view text) {
  while (!text.empty()) {
    const ssize_t done = write(fd, text.data(), text.size());
    if (done < 0 && errno == EINTR) continue;
    if (done <= 0) return false;
    text.remove_prefix(static_cast<size_t>(done));
  }
  return true;
}

Status Complaint(const std::string& verb, const std::filesystem::path& file) {
  return Status::Failed("cannot " + verb + " " + file.string() + ": " + std::strerror(errno));
}

}  // namespace

Status SyncFolder(const std::filesystem::path& folder) {
  const Descriptor fd(open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!fd.ok() || fsync(fd.get()) != 0) return Complaint("sync", folder);
  return Status::Ok();
}

Status WriteFileDurably(const std::filesystem::path& file, const std::string& text) {
  const std::filesystem::path temporary = file.string() + ".new";
  {
    const Descriptor fd(open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0640));
    if (!fd.ok() || !WriteAll(fd.get(), text) || fsync(fd.get()) != 0) return Complaint("write", temporary);
  }
  if (rename(temporary.c_str(), file.c_str()) != 0) return Complaint("write", file);
  return SyncFolder(file.parent_path());
}

Status WipeFile(const std::filesystem::path& file) {
  {
    const Descriptor fd(open(file.c_str(), O_WRONLY | O_CLOEXEC));
    if (!fd.ok()) return errno == ENOENT ? Status::Ok() : Complaint("wipe", file);
    struct stat info {};
    if (fstat(fd.get(), &info) != 0) return Complaint("wipe", file);
    const std::string zeros(64 * 1024, '\0');
    for (auto left = static_cast<size_t>(info.st_size); left > 0;) {
      const size_t part = std::min(left, zeros.size());
      if (!WriteAll(fd.get(), std::string_view(zeros).substr(0, part))) return Complaint("wipe", file);
      left -= part;
    }
    if (fdatasync(fd.get()) != 0) return Complaint("wipe", file);
  }
  if (unlink(file.c_str()) != 0 && errno != ENOENT) return Complaint("remove", file);
  return Status::Ok();
}

}  // namespace stratalux::db
