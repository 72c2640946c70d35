// SPDX-License-Identifier: Apache-2.0
#include "tests/db/crash/disk_recorder.h"

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <mutex>
#include <optional>
#include <utility>

#include <fcntl.h>
#include <limits.h>
#include <unistd.h>

#include "tests/db/crash/disk_hooks.h"
#include "tests/support/text_file.h"

namespace stratalux::db::crash {
namespace {

namespace fs = std::filesystem;
using Kind = DiskCall::Kind;

struct Recording {
  std::string root;  // absolute, without a trailing '/'
  DiskLog log;
  std::map<std::string, Inode> names;  // now; the root is ""
  std::map<int, Inode> open_files;
  Inode next = kRoot + 1;
  DiskFault fault;
  int64_t space_calls = 0, sync_calls = 0, failed = 0;
  bool half_was_written = false;
};

// Never destroyed: files are closed until the very end of the program.
Recording* recording = nullptr;
bool skip_syncs = false;

std::recursive_mutex& Mutex() {
  static auto* mutex = new std::recursive_mutex;
  return *mutex;
}
using Lock = std::lock_guard<std::recursive_mutex>;

// Below the root; nullopt elsewhere.
std::optional<std::string> Relative(const char* path) {
  if (recording == nullptr) return std::nullopt;
  std::string full = path;
  if (full.empty() || full[0] != '/') {
    char here[PATH_MAX];
    if (getcwd(here, sizeof here) == nullptr) return std::nullopt;
    full = std::string(here) + "/" + full;
  }
  full = fs::path(full).lexically_normal().string();
  while (full.size() > 1 && full.back() == '/') full.pop_back();
  if (full == recording->root) return "";
  if (!full.starts_with(recording->root + "/")) return std::nullopt;
  return full.substr(recording->root.size() + 1);
}

std::pair<Inode, std::string> Split(const std::string& path) {
  const size_t slash = path.rfind('/');
  const std::string parent = slash == std::string::npos ? "" : path.substr(0, slash);
  const auto found = recording->names.find(parent);
  return {found == recording->names.end() ? -1 : found->second,
          slash == std::string::npos ? path : path.substr(slash + 1)};
}

void Link(const std::string& path, bool folder) {
  const Inode inode = recording->next++;
  recording->names[path] = inode;
  DiskCall call;
  call.kind = Kind::kLink;
  call.file = inode;
  call.makes_folder = folder;
  std::tie(call.folder, call.name) = Split(path);
  recording->log.calls.push_back(call);
}

void Note(Kind kind, Inode inode, int64_t offset, const void* data = nullptr, size_t size = 0);

// What another program (rsync) made below the root is written down when this one first meets it: as new, none of it
// synced.
void Discover(const std::string& path) {
  if (path.empty() || recording->names.contains(path)) return;
  const size_t slash = path.rfind('/');
  if (slash != std::string::npos) Discover(path.substr(0, slash));
  const fs::path file = fs::path(recording->root) / path;
  std::error_code error;
  const auto type = fs::symlink_status(file, error).type();
  if (type != fs::file_type::regular && type != fs::file_type::directory) return;
  Link(path, type == fs::file_type::directory);
  if (type == fs::file_type::directory) {
    std::vector<std::string> inside;
    for (const auto& entry : fs::directory_iterator(file, error))
      inside.push_back(path + "/" + entry.path().filename().string());
    std::sort(inside.begin(), inside.end());
    for (const std::string& name : inside) Discover(name);
    return;
  }
  const std::string bytes = ReadText(file);
  if (!bytes.empty()) Note(Kind::kWrite, recording->names[path], 0, bytes.data(), bytes.size());
}

std::optional<Inode> InodeOf(int fd) {
  if (recording == nullptr) return std::nullopt;
  const auto found = recording->open_files.find(fd);
  if (found == recording->open_files.end()) return std::nullopt;
  return found->second;
}

void Note(Kind kind, Inode inode, int64_t offset, const void* data, size_t size) {
  DiskCall call;
  call.kind = kind;
  call.file = inode;
  call.offset = offset;
  if (size > 0) call.bytes.assign(static_cast<const uint8_t*>(data), static_cast<const uint8_t*>(data) + size);
  recording->log.calls.push_back(std::move(call));
}

// True when the fault strikes the call numbered `count`.
bool Strikes(DiskFault::Kind kind, int64_t count) {
  const DiskFault& f = recording->fault;
  return f.kind == kind && (count == f.at || (f.extent == DiskFault::Extent::kFromThenOn && count > f.at));
}

int SpaceRefusal() {
  const int64_t count = recording->space_calls++;
  if (Strikes(DiskFault::Kind::kDeath, count)) std::raise(SIGKILL);
  if (Strikes(DiskFault::Kind::kInterruption, count)) kill(getpid(), SIGINT);
  if (!Strikes(DiskFault::Kind::kNoSpace, count)) return 0;
  ++recording->failed;
  return ENOSPC;
}

}  // namespace

void StartRecording(const fs::path& folder, const DiskFault& fault, StartImage image) {
  auto* fresh = new Recording;
  fresh->root = fs::canonical(folder).string();
  fresh->fault = fault;
  fresh->names[""] = kRoot;
  if (image == StartImage::kRead) fresh->log.start = ReadImage(folder);
  for (const auto& [path, bytes] : fresh->log.start)
    fresh->names[path.ends_with('/') ? path.substr(0, path.size() - 1) : path] = fresh->next++;
  fresh->log.inodes = fresh->names;
  const Lock lock(Mutex());
  delete recording;
  recording = fresh;
}

void Mark(int64_t promises) {
  const Lock lock(Mutex());
  Note(Kind::kMark, -1, promises);
}
void RepairDisk() {
  const Lock lock(Mutex());
  recording->fault = {};
  recording->half_was_written = false;
}

DiskLog StopRecording() {
  const Lock lock(Mutex());
  DiskLog log = std::move(recording->log);
  delete recording;
  recording = nullptr;
  return log;
}

int64_t CallsThatCanFail(DiskFault::Kind kind) {
  if (recording == nullptr) return 0;
  return kind == DiskFault::Kind::kSyncError ? recording->sync_calls : recording->space_calls;
}
int64_t CallsThatFailed() { return recording->failed; }
void SkipSyncs() { skip_syncs = true; }

DiskImage ReadImage(const fs::path& folder) {
  DiskImage image;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    std::string name = fs::relative(entry.path(), folder).string();
    if (entry.is_directory()) {
      image[name + "/"] = {};
      continue;
    }
    const std::string bytes = ReadText(entry.path());
    image[name] = {bytes.begin(), bytes.end()};
  }
  return image;
}

void WriteImage(const DiskImage& image, const fs::path& folder) {
  fs::remove_all(folder);
  fs::create_directories(folder);
  for (const auto& [path, bytes] : image) {  // a folder sorts before what it holds
    if (path.ends_with('/')) {
      fs::create_directory(folder / path.substr(0, path.size() - 1));
      continue;
    }
    std::ofstream out(folder / path, std::ios::binary);
    out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    if (!out.flush()) std::abort();
  }
}

// ---- hooks

int RefusalOf(const char* path) {
  const Lock lock(Mutex());
  return Relative(path) ? SpaceRefusal() : 0;
}
int RefusalOf(int fd) {
  const Lock lock(Mutex());
  return InodeOf(fd) ? SpaceRefusal() : 0;
}

size_t SpaceFor(int fd, size_t size) {
  const Lock lock(Mutex());
  if (!InodeOf(fd) || size == 0) return size;
  if (!std::exchange(recording->half_was_written, false)) {
    if (SpaceRefusal() == 0) return size;
    recording->half_was_written = true;
    if (size > 1) return size / 2;
  }
  recording->half_was_written = false;
  return 0;
}

void MayDie(const char* path) {
  const Lock lock(Mutex());
  if (Relative(path) && recording->fault.kind >= DiskFault::Kind::kDeath) (void)SpaceRefusal();
}
void MayDie(int fd) {
  const Lock lock(Mutex());
  if (InodeOf(fd) && recording->fault.kind >= DiskFault::Kind::kDeath) (void)SpaceRefusal();
}

int SyncRefusalOf(int fd) {
  const Lock lock(Mutex());
  const auto inode = InodeOf(fd);
  if (!inode || !Strikes(DiskFault::Kind::kSyncError, recording->sync_calls++)) return 0;
  ++recording->failed;
  Note(Kind::kFailedSync, *inode, 0);
  return EIO;
}

bool SyncIsSkipped() { return skip_syncs || recording != nullptr; }
bool IsRecorded(int fd) {
  const Lock lock(Mutex());
  return InodeOf(fd).has_value();
}

void NoteOpen(int fd, const char* path, int flags) {
  const Lock lock(Mutex());
  if (recording == nullptr) return;
  recording->open_files.erase(fd);  // closed where no hook sees it, as fclose does
  const auto name = Relative(path);
  if (!name) return;
  if ((flags & (O_CREAT | O_EXCL)) == (O_CREAT | O_EXCL)) {
    Link(*name, false);
  } else {
    Discover(*name);
  }
  const auto known = recording->names.find(*name);
  if (known == recording->names.end()) return;
  recording->open_files[fd] = known->second;
  if ((flags & O_TRUNC) != 0) Note(Kind::kTruncate, known->second, 0);
}

void NoteClose(int fd) {
  const Lock lock(Mutex());
  if (recording != nullptr) recording->open_files.erase(fd);
}

void NoteWrite(int fd, const void* data, size_t size, int64_t offset) {
  const Lock lock(Mutex());
  if (const auto inode = InodeOf(fd)) Note(Kind::kWrite, *inode, offset, data, size);
}

void NoteTruncate(int fd, int64_t size) {
  const Lock lock(Mutex());
  if (const auto inode = InodeOf(fd)) Note(Kind::kTruncate, *inode, size);
}

void NoteTruncate(const char* path, int64_t size) {
  const Lock lock(Mutex());
  const auto name = Relative(path);
  if (name && recording->names.contains(*name)) Note(Kind::kTruncate, recording->names[*name], size);
}

void NoteSync(int fd) {
  const Lock lock(Mutex());
  if (const auto inode = InodeOf(fd)) Note(Kind::kSync, *inode, 0);
}

void NoteRename(const char* from, const char* to) {
  const Lock lock(Mutex());
  const auto old_name = Relative(from), name = Relative(to);
  if (!old_name || !name) return;
  if (!recording->names.contains(*old_name)) {
    // Made elsewhere and moved within the root by now: it is known under its new name.
    recording->names.erase(*name);
    return Discover(*name);
  }
  DiskCall call;
  call.kind = Kind::kLink;
  call.file = recording->names[*old_name];
  std::tie(call.folder, call.name) = Split(*name);
  std::tie(call.old_folder, call.old_name) = Split(*old_name);
  recording->log.calls.push_back(call);
  std::map<std::string, Inode> moved;
  for (const auto& [path, inode] : recording->names) {
    const bool inside = path == *old_name || path.starts_with(*old_name + "/");
    if (inside) moved[*name + path.substr(old_name->size())] = inode;
    if (!inside && path != *name) moved.emplace(path, inode);
  }
  recording->names = std::move(moved);
}

void NoteUnlink(const char* path) {
  const Lock lock(Mutex());
  const auto name = Relative(path);
  if (!name) return;
  DiskCall call;
  call.kind = Kind::kUnlink;
  std::tie(call.folder, call.name) = Split(*name);
  recording->log.calls.push_back(call);
  recording->names.erase(*name);
}

void NoteHardLink(const char* from, const char* to) {
  const Lock lock(Mutex());
  const auto old_name = Relative(from), name = Relative(to);
  if (!old_name || !name || !recording->names.contains(*old_name)) return;
  DiskCall call;
  call.kind = Kind::kLink;
  call.file = recording->names[*old_name];
  std::tie(call.folder, call.name) = Split(*name);
  recording->names[*name] = call.file;
  recording->log.calls.push_back(call);
}

void NoteMakeFolder(const char* path) {
  const Lock lock(Mutex());
  if (const auto name = Relative(path)) Link(*name, true);
}

std::string PathAt(int folder_fd, const char* path) {
  if (path[0] == '/' || folder_fd == AT_FDCWD || recording == nullptr) return path;
  char link[64], folder[PATH_MAX];
  std::snprintf(link, sizeof link, "/proc/self/fd/%d", folder_fd);
  const ssize_t length = readlink(link, folder, sizeof folder);
  return length > 0 ? std::string(folder, static_cast<size_t>(length)) + "/" + path : path;
}

}  // namespace stratalux::db::crash
