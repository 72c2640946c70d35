// SPDX-License-Identifier: Apache-2.0
// libc's file calls, wrapped. A definition in the program (or in a preloaded library) comes before libc's, also for the
// calls of SQLite and libstdc++.
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstring>

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#include "tests/db/crash/disk_hooks.h"

namespace {

using namespace stratalux::db::crash;  // NOLINT(google-build-using-namespace): this file is that namespace's C face

template <typename F>
F* Real(F*& cached, const char* name) {
  if (cached == nullptr) {
    void* symbol = dlsym(RTLD_NEXT, name);
    std::memcpy(&cached, &symbol, sizeof symbol);
  }
  return cached;
}

// errno as the call left it, whatever the notes did to it.
class KeepErrno {
 public:
  KeepErrno() : saved_(errno) {}
  ~KeepErrno() { errno = saved_; }
  KeepErrno(const KeepErrno&) = delete;
  KeepErrno& operator=(const KeepErrno&) = delete;

 private:
  int saved_;
};

bool Refuse(int error) {
  if (error == 0) return false;
  errno = error;
  return true;
}

template <typename F>
int OpenBy(const char* path, int flags, F&& real) {
  const bool creates = (flags & O_CREAT) != 0 && access(path, F_OK) != 0;
  if (creates && Refuse(RefusalOf(path))) return -1;
  const int fd = real();
  const KeepErrno keep;
  if (fd >= 0) NoteOpen(fd, path, flags | (creates ? O_EXCL : 0));
  return fd;
}

template <typename F>
std::FILE* FileOpenBy(const char* path, const char* mode, F&& real) {
  const bool writes = std::strpbrk(mode, "wa+") != nullptr, creates = mode[0] != 'r' && access(path, F_OK) != 0;
  if (creates && Refuse(RefusalOf(path))) return nullptr;
  std::FILE* file = real();
  const KeepErrno keep;
  if (file != nullptr)
    NoteOpen(fileno(file), path,
             (writes ? O_RDWR : O_RDONLY) | (creates ? O_CREAT | O_EXCL : 0) | (mode[0] == 'w' ? O_TRUNC : 0));
  return file;
}

int64_t PositionOf(int fd) {
  if (!IsRecorded(fd)) return 0;
  if ((fcntl(fd, F_GETFL) & O_APPEND) != 0) {
    struct stat info {};
    return fstat(fd, &info) == 0 ? info.st_size : 0;
  }
  return lseek(fd, 0, SEEK_CUR);
}

template <typename F>
ssize_t WriteBy(int fd, const void* data, size_t size, int64_t offset, F&& real) {
  const size_t fits = SpaceFor(fd, size);
  if (fits == 0 && size > 0 && Refuse(ENOSPC)) return -1;
  const ssize_t done = real(data, fits);
  const KeepErrno keep;
  if (done > 0) NoteWrite(fd, data, static_cast<size_t>(done), offset);
  return done;
}

template <typename F>
int SyncBy(int fd, F&& real) {
  MayDie(fd);
  if (Refuse(SyncRefusalOf(fd))) return -1;
  const int result = SyncIsSkipped() ? 0 : real();
  const KeepErrno keep;
  if (result == 0) NoteSync(fd);
  return result;
}

}  // namespace

#define SLX_REAL(name)                  \
  static decltype(&name) cached_##name; \
  const auto real = Real(cached_##name, #name)
#define SLX_MODE(flags)          \
  mode_t mode = 0;               \
  if (((flags)&O_CREAT) != 0) {  \
    va_list list;                \
    va_start(list, flags);       \
    mode = va_arg(list, mode_t); \
    va_end(list);                \
  }

extern "C" {

int open(const char* path, int flags, ...) {
  SLX_MODE(flags)
  SLX_REAL(open);
  return OpenBy(path, flags, [&] { return real(path, flags, mode); });
}
int open64(const char* path, int flags, ...) {
  SLX_MODE(flags)
  SLX_REAL(open64);
  return OpenBy(path, flags, [&] { return real(path, flags, mode); });
}
int openat(int folder, const char* path, int flags, ...) {
  SLX_MODE(flags)
  SLX_REAL(openat);
  return OpenBy(PathAt(folder, path).c_str(), flags, [&] { return real(folder, path, flags, mode); });
}
std::FILE* fopen(const char* path, const char* mode) {
  SLX_REAL(fopen);
  return FileOpenBy(path, mode, [&] { return real(path, mode); });
}
std::FILE* fopen64(const char* path, const char* mode) {
  SLX_REAL(fopen64);
  return FileOpenBy(path, mode, [&] { return real(path, mode); });
}
int close(int fd) {
  SLX_REAL(close);
  NoteClose(fd);
  return real(fd);
}

ssize_t write(int fd, const void* data, size_t size) {
  SLX_REAL(write);
  const int64_t at = PositionOf(fd);
  return WriteBy(fd, data, size, at, [&](const void* d, size_t n) { return real(fd, d, n); });
}
ssize_t pwrite(int fd, const void* data, size_t size, off_t offset) {
  SLX_REAL(pwrite);
  return WriteBy(fd, data, size, offset, [&](const void* d, size_t n) { return real(fd, d, n, offset); });
}
ssize_t pwrite64(int fd, const void* data, size_t size, off64_t offset) {
  SLX_REAL(pwrite64);
  return WriteBy(fd, data, size, offset, [&](const void* d, size_t n) { return real(fd, d, n, offset); });
}
ssize_t writev(int fd, const iovec* parts, int count) {
  SLX_REAL(writev);
  if (!IsRecorded(fd)) return real(fd, parts, count);
  ssize_t total = 0;
  for (int i = 0; i < count; ++i) {
    if (parts[i].iov_len == 0) continue;
    const ssize_t done = write(fd, parts[i].iov_base, parts[i].iov_len);
    if (done < 0) return total > 0 ? total : -1;
    total += done;
    if (static_cast<size_t>(done) < parts[i].iov_len) break;
  }
  return total;
}
// libstdc++ then copies by read and write, which are seen here.
ssize_t sendfile(int out, int in, off_t* offset, size_t size) noexcept {
  SLX_REAL(sendfile);
  if (!IsRecorded(out)) return real(out, in, offset, size);
  errno = EINVAL;
  return -1;
}

int ftruncate(int fd, off_t size) noexcept {
  SLX_REAL(ftruncate);
  if (Refuse(RefusalOf(fd))) return -1;
  const int result = real(fd, size);
  const KeepErrno keep;
  if (result == 0) NoteTruncate(fd, size);
  return result;
}
int ftruncate64(int fd, off64_t size) noexcept {
  SLX_REAL(ftruncate64);
  if (Refuse(RefusalOf(fd))) return -1;
  const int result = real(fd, size);
  const KeepErrno keep;
  if (result == 0) NoteTruncate(fd, size);
  return result;
}
int truncate(const char* path, off_t size) noexcept {
  SLX_REAL(truncate);
  if (Refuse(RefusalOf(path))) return -1;
  const int result = real(path, size);
  const KeepErrno keep;
  if (result == 0) NoteTruncate(path, size);
  return result;
}

int fsync(int fd) {
  SLX_REAL(fsync);
  return SyncBy(fd, [&] { return real(fd); });
}
int fdatasync(int fd) {
  SLX_REAL(fdatasync);
  return SyncBy(fd, [&] { return real(fd); });
}

int rename(const char* from, const char* to) noexcept {
  SLX_REAL(rename);
  if (Refuse(RefusalOf(to))) return -1;
  const int result = real(from, to);
  const KeepErrno keep;
  if (result == 0) NoteRename(from, to);
  return result;
}
int link(const char* from, const char* to) noexcept {
  SLX_REAL(link);
  if (Refuse(RefusalOf(to))) return -1;
  const int result = real(from, to);
  const KeepErrno keep;
  if (result == 0) NoteHardLink(from, to);
  return result;
}
int linkat(int from_folder, const char* from, int to_folder, const char* to, int flags) noexcept {
  SLX_REAL(linkat);
  const std::string source = PathAt(from_folder, from), target = PathAt(to_folder, to);
  if (Refuse(RefusalOf(target.c_str()))) return -1;
  const int result = real(from_folder, from, to_folder, to, flags);
  const KeepErrno keep;
  if (result == 0) NoteHardLink(source.c_str(), target.c_str());
  return result;
}
int unlink(const char* path) noexcept {
  SLX_REAL(unlink);
  MayDie(path);
  const int result = real(path);
  const KeepErrno keep;
  if (result == 0) NoteUnlink(path);
  return result;
}
int unlinkat(int folder, const char* path, int flags) noexcept {
  SLX_REAL(unlinkat);
  const std::string full = PathAt(folder, path);
  MayDie(full.c_str());
  const int result = real(folder, path, flags);
  const KeepErrno keep;
  if (result == 0) NoteUnlink(full.c_str());
  return result;
}
int remove(const char* path) noexcept {
  SLX_REAL(remove);
  MayDie(path);
  const int result = real(path);
  const KeepErrno keep;
  if (result == 0) NoteUnlink(path);
  return result;
}
int mkdir(const char* path, mode_t mode) noexcept {
  SLX_REAL(mkdir);
  if (access(path, F_OK) != 0 && Refuse(RefusalOf(path))) return -1;
  const int result = real(path, mode);
  const KeepErrno keep;
  if (result == 0) NoteMakeFolder(path);
  return result;
}

}  // extern "C"
