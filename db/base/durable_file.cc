// SPDX-License-Identifier: Apache-2.0
#include "db/base/durable_file.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/descriptor.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

Status Failure(const std::string& what, const fs::path& file, int error) {
  return Status::Failed("cannot " + what + " " + file.string() + ": " + std::strerror(error));
}

Status SyncOpened(const fs::path& file, int flags) {
  const UniqueFd opened = OpenDescriptor(file, flags | O_NOFOLLOW);
  if (opened.get() < 0) return Failure("open", file, errno);
  if (fsync(opened.get()) != 0) return Failure("sync", file, errno);
  return Status::Ok();
}

Status WriteWhole(const fs::path& file, const std::string& bytes) {
  const UniqueFd opened = OpenDescriptor(file, O_WRONLY | O_CREAT | O_TRUNC | O_NOFOLLOW);
  if (opened.get() < 0) return Failure("create", file, errno);
  return WriteAll(opened.get(), bytes.data(), bytes.size(), file.string());
}

}  // namespace

Status WriteAll(int fd, const void* data, size_t size, const std::string& file) {
  const char* at = static_cast<const char*>(data);
  while (size > 0) {
    const ssize_t done = write(fd, at, size);
    if (done < 0 && errno == EINTR) continue;
    if (done < 0) return Failure("write", file, errno);
    if (done == 0) return Failure("write", file, ENOSPC);
    at += done;
    size -= static_cast<size_t>(done);
  }
  return Status::Ok();
}

Status SyncFolder(const fs::path& folder) {
  const UniqueFd opened = OpenDescriptor(folder.empty() ? "." : folder, O_RDONLY | O_DIRECTORY);
  if (opened.get() < 0) return Failure("open folder", folder, errno);
  if (fsync(opened.get()) != 0) return Failure("sync folder", folder, errno);
  return Status::Ok();
}

Status MakeFolder(const fs::path& folder) {
  std::vector<fs::path> missing;
  std::error_code error;
  for (fs::path at = folder; !at.empty() && !fs::exists(at, error); at = at.parent_path()) missing.push_back(at);
  for (; !missing.empty(); missing.pop_back()) {
    const fs::path& next = missing.back();
    if (next.filename().empty()) continue;  // "store/"
    fs::create_directory(next, error);
    if (error) return Status::Failed("cannot create " + next.string() + ": " + error.message());
    SLX_RETURN_IF_ERROR(SyncFolder(next.parent_path()));
  }
  if (!fs::is_directory(folder, error)) return Failure("create", folder, error ? error.value() : ENOTDIR);
  return Status::Ok();
}

Status ReplaceFile(const fs::path& file, const std::string& bytes) {
  fs::path beside = file;
  beside += ".new";
  Status written = WriteWhole(beside, bytes);
  if (written.ok()) written = KeepFile(beside, file);
  if (!written.ok()) unlink(beside.c_str());
  return written;
}

Status KeepFile(const fs::path& beside, const fs::path& file) {
  SLX_RETURN_IF_ERROR(SyncOpened(beside, O_RDONLY));
  if (rename(beside.c_str(), file.c_str()) != 0) return Failure("write", file, errno);
  return SyncFolder(file.parent_path());
}

Status WipeFile(const fs::path& file) {
  {
    const UniqueFd opened = OpenDescriptor(file, O_WRONLY | O_NOFOLLOW);
    if (opened.get() < 0) return errno == ENOENT ? Status::Ok() : Failure("wipe", file, errno);
    struct stat info {};
    if (fstat(opened.get(), &info) != 0) return Failure("wipe", file, errno);
    const std::string zeros(64 * 1024, '\0');
    for (auto left = static_cast<size_t>(info.st_size); left > 0;) {
      const size_t part = std::min(left, zeros.size());
      SLX_RETURN_IF_ERROR(WriteAll(opened.get(), zeros.data(), part, file.string()));
      left -= part;
    }
    if (fdatasync(opened.get()) != 0) return Failure("wipe", file, errno);
  }
  if (unlink(file.c_str()) != 0 && errno != ENOENT) return Failure("remove", file, errno);
  return Status::Ok();
}

Status CutFile(const fs::path& file, int64_t size) {
  const UniqueFd opened = OpenDescriptor(file, O_WRONLY | O_NOFOLLOW);
  if (opened.get() < 0) return Failure("cut", file, errno);
  if (ftruncate(opened.get(), size) != 0) return Failure("cut", file, errno);
  if (fsync(opened.get()) != 0) return Failure("sync", file, errno);
  return Status::Ok();
}

Status SyncFile(const fs::path& file) {
  std::error_code error;
  return fs::is_regular_file(fs::symlink_status(file, error)) ? SyncOpened(file, O_RDONLY) : Status::Ok();
}

Status SyncTree(const fs::path& folder) {
  std::error_code error;
  std::vector<fs::path> folders = {folder};
  for (auto entry = fs::recursive_directory_iterator(folder, error); !error && entry != fs::end(entry);
       entry.increment(error)) {
    if (entry->is_symlink(error)) continue;
    if (entry->is_directory(error)) {
      folders.push_back(entry->path());
    } else if (entry->is_regular_file(error)) {
      SLX_RETURN_IF_ERROR(SyncOpened(entry->path(), O_RDONLY));
    }
  }
  if (error) return Status::Failed("cannot read " + folder.string() + ": " + error.message());
  for (; !folders.empty(); folders.pop_back()) SLX_RETURN_IF_ERROR(SyncFolder(folders.back()));
  return Status::Ok();
}

}  // namespace stratalux::db
