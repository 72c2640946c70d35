// SPDX-License-Identifier: Apache-2.0
// For programs that never migrate a store.
#pragma once

#include <filesystem>

#include "shared/base/result.h"

namespace stratalux::db {

// kOk: the index is there, ours and of this program's schema. kFailed for an older one, with the remedy; otherwise as
// SessionStore::Open. Writes nothing.
Status RequireCurrentSchema(const std::filesystem::path& store);

}  // namespace stratalux::db
