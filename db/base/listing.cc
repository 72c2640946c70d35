// SPDX-License-Identifier: Apache-2.0
#include "db/base/listing.h"

#include <algorithm>
#include <system_error>
#include <type_traits>

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

template <typename Iterator>
Result<std::vector<fs::path>> List(const fs::path& folder) {
  std::vector<fs::path> paths;
  std::error_code error;
  Iterator entry(folder, error);
  for (; !error && entry != Iterator(); entry.increment(error)) {
    const fs::path path = entry->path();
    std::error_code unknown;
    const bool is_folder = fs::is_directory(fs::symlink_status(path, unknown));
    if (!std::is_same_v<Iterator, fs::recursive_directory_iterator> || !is_folder) paths.push_back(path);
  }
  if (error && error != std::errc::no_such_file_or_directory)
    return Status::Failed("cannot list " + folder.string() + ": " + error.message());
  std::sort(paths.begin(), paths.end());
  return paths;
}

}  // namespace

Result<std::vector<fs::path>> EntriesOf(const fs::path& folder) { return List<fs::directory_iterator>(folder); }

Result<std::vector<fs::path>> FilesUnder(const fs::path& folder) {
  return List<fs::recursive_directory_iterator>(folder);
}

}  // namespace stratalux::db
