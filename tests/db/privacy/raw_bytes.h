// SPDX-License-Identifier: Apache-2.0
// The bytes of a store as a stranger with a hex editor sees them: an oracle that knows neither SQLite nor our formats.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace stratalux::db {

// Path below `folder` -> bytes, of every file: also logs, journals and what deleted rows may have left in pages. No
// connection to the store may be open: closing a file drops SQLite's locks.
using RawFiles = std::map<std::string, std::string>;
[[nodiscard]] RawFiles ReadRaw(const std::filesystem::path& folder);
// path -> how often it holds `text`; only files that do.
[[nodiscard]] std::map<std::string, int> FilesWith(const RawFiles& raw, const std::string& text);

}  // namespace stratalux::db
