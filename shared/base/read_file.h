// SPDX-License-Identifier: Apache-2.0
// A whole file at once.
#pragma once

#include <filesystem>
#include <string>

#include "shared/base/result.h"

namespace stratalux {

// The bytes of `file`. kNotFound where it cannot be opened, kFailed where it cannot be read (a folder, a broken disk);
// the message names file and reason.
[[nodiscard]] Result<std::string> ReadFile(const std::filesystem::path& file);

}  // namespace stratalux
