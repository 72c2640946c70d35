// SPDX-License-Identifier: Apache-2.0
// backup.json: every file of a backup with its size and hash (docs/file-formats.md, "Files of transfers").
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::db {

// In a backup: the journal of a run at work or broken off.
inline constexpr const char* kBackupJournal = "backup.unfinished";

struct ListedFile {
  int64_t bytes = 0;
  int64_t source_mtime_ns = 0;  // of the file that was copied: the same size and time mean the same file
  std::string hash;             // XXH3-128, 32 hex digits
  WallNs checked_wall;          // when the bytes of the copy last matched; 0: never, or they no longer do
};

struct FileList {
  WallNs made_wall;
  std::string program_version;
  int64_t scrub_runs = 0;                   // each copy is reread within so many backups
  std::vector<std::string> problems;        // of the backup that wrote the list
  std::map<std::string, ListedFile> files;  // path within the backup -> file
  bool intact = true;  // false: read although it does not match its own hash; it may lack files. Older ones have none
};

Status WriteFileList(const std::filesystem::path& folder, const FileList& list);
// kNotFound where `folder` is no (finished) backup; kIntegrity for a damaged list, and for paths that leave the folder;
// kNewerSchema.
[[nodiscard]] Result<FileList> ReadFileList(const std::filesystem::path& folder);

// One file as one line of JSON, for the journal of a backup that is being made.
[[nodiscard]] std::string ListedFileLine(const std::string& path, const ListedFile& file);
[[nodiscard]] std::optional<std::pair<std::string, ListedFile>> ParseListedFileLine(const std::string& line);

// "sessions/<id>/..." -> <id>; empty for other paths.
[[nodiscard]] std::string SessionOfPath(const std::string& path);

}  // namespace stratalux::db
