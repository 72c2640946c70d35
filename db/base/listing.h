// SPDX-License-Identifier: Apache-2.0
// What lies in a folder, as a list: the library's iterators throw where a folder within cannot be read.
#pragma once

#include <filesystem>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::db {

// Entries of a folder itself, or all within it that is no folder (links are not followed); by name. None where there is
// no such folder; kFailed names what cannot be listed.
[[nodiscard]] Result<std::vector<std::filesystem::path>> EntriesOf(const std::filesystem::path& folder);
[[nodiscard]] Result<std::vector<std::filesystem::path>> FilesUnder(const std::filesystem::path& folder);

}  // namespace stratalux::db
