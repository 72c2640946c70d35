// SPDX-License-Identifier: Apache-2.0
#include "tests/db/privacy/raw_bytes.h"

#include "tests/db/store_fixture.h"

namespace stratalux::db {

RawFiles ReadRaw(const std::filesystem::path& folder) {
  RawFiles raw;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file()) continue;
    const auto bytes = ReadBytes(entry.path());
    raw[entry.path().lexically_relative(folder).string()] = std::string(bytes.begin(), bytes.end());
  }
  return raw;
}

std::map<std::string, int> FilesWith(const RawFiles& raw, const std::string& text) {
  std::map<std::string, int> files;
  for (const auto& [file, bytes] : raw)
    for (size_t at = bytes.find(text); at != std::string::npos; at = bytes.find(text, at + 1)) ++files[file];
  return files;
}

}  // namespace stratalux::db
