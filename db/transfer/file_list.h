// SPDX-License-Identifier: Apache-2.0
// backup.json: every file of a backup with its size and hash (docs/file-formats.md).
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>

#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::db {

struct ListedFile {
  int64_t bytes = 0;
  int64_t source_mtime_ns = 0;  // of the file that was copied: the same size and time mean the same file
  std::string hash;             // XXH3-128, 32 hex digits
};

struct FileList {
  WallNs made_wall;
  std::string program_version;
  std::map<std::string, ListedFile> files;  // path within the backup -> file
};

Status WriteFileList(const std::filesystem::path& folder, const FileList& list);
// kNotFound where `folder` is no backup; kIntegrity for a damaged list, and for paths that leave the folder.
[[nodiscard]] Result<FileList> ReadFileList(const std::filesystem::path& folder);

}  // namespace stratalux::db
