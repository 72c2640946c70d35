// SPDX-License-Identifier: Apache-2.0
#include "db/base/held_descriptor.h"

#include <map>
#include <mutex>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>

#include "db/base/descriptor.h"

namespace stratalux::db {
namespace {

using FileId = std::pair<dev_t, ino_t>;

// The locks are the process's, so what guards them is, too.
struct Held {
  std::mutex mutex;
  std::multimap<FileId, UniqueFd> files;
};

Held& OfProcess() {
  static Held& held = *new Held;  // not even at exit, while threads may still write
  return held;
}

FileId IdOf(const struct stat& status) { return {status.st_dev, status.st_ino}; }

// A file without a name is nobody's to open: whoever locks it excludes nobody any more.
void CloseNameless(std::multimap<FileId, UniqueFd>& files) {
  std::erase_if(files, [](const auto& file) {
    struct stat status {};
    return fstat(file.second.get(), &status) == 0 && status.st_nlink == 0;
  });
}

}  // namespace

bool MayBeOfSqlite(const std::filesystem::path& file) {
  const auto extension = file.extension();
  return extension == ".sqlite" || extension == ".sqlite-shm";
}

int HeldDescriptor(const std::filesystem::path& file) {
  Held& held = OfProcess();
  const std::scoped_lock lock(held.mutex);
  CloseNameless(held.files);
  struct stat status {};
  if (stat(file.c_str(), &status) != 0) return -1;
  if (const auto found = held.files.find(IdOf(status)); found != held.files.end()) return found->second.get();
  UniqueFd fd = OpenDescriptor(file, O_RDONLY);
  if (!fd.ok() || fstat(fd.get(), &status) != 0) return -1;
  return held.files.emplace(IdOf(status), std::move(fd))->second.get();
}

}  // namespace stratalux::db
