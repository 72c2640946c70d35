// SPDX-License-Identifier: Apache-2.0
// The files of a folder as its record lists them: name, size and hash of each (fit.json, artifact.json).
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::db {

// XXH3-128 of a file's bytes, 32 hex digits.
[[nodiscard]] Result<std::string> HashOfFile(const std::filesystem::path& file);

struct RecordedFile {
  std::string name;  // within the folder
  int64_t bytes = 0;
  std::string xxh3_128;  // 32 hex digits
  friend bool operator==(const RecordedFile&, const RecordedFile&) = default;
};

// Regular files at and below the folder, sorted by name; `record` is none of its own.
[[nodiscard]] Result<std::vector<RecordedFile>> ListFiles(const std::filesystem::path& folder,
                                                          const std::string& record);
// The same without sizes and hashes.
[[nodiscard]] Result<std::vector<std::string>> NamesOfFiles(const std::filesystem::path& folder,
                                                            const std::string& record);

enum class FileDepth { kSizes, kHashes };
// kIntegrity names the file that is missing, another one, or a link; or leads out of the folder.
Status CheckRecordedFile(const std::filesystem::path& folder, const std::string& record, const RecordedFile& file,
                         FileDepth depth);

}  // namespace stratalux::db
