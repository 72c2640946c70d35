// SPDX-License-Identifier: Apache-2.0
// What a killed program may have left of a file that nobody else may read, such as one of keys.
#pragma once

#include <filesystem>

#include "shared/base/result.h"

namespace stratalux::db {

enum class PrivateLeftover {
  kNone,     // nothing is there
  kOurs,     // a regular file of this account under one name, with no mode for others
  kForeign,  // anything else, a link among it
};

[[nodiscard]] Result<PrivateLeftover> FindPrivateLeftover(const std::filesystem::path& file);

}  // namespace stratalux::db
