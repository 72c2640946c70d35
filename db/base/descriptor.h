// SPDX-License-Identifier: Apache-2.0
// Opening of the store's files. Internal to db/.
#pragma once

#include <filesystem>

#include "shared/base/unique_fd.h"

namespace stratalux::db {

// `flags` of open(2); a new file is for owner and group. Not ok(), with errno, where the file cannot be opened.
[[nodiscard]] UniqueFd OpenDescriptor(const std::filesystem::path& file, int flags);

}  // namespace stratalux::db
