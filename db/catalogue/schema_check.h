// SPDX-License-Identifier: Apache-2.0
// For programs that never migrate a store, or come too late to: an index of another schema.
#pragma once

#include <cstdint>
#include <filesystem>

#include "shared/base/result.h"

namespace stratalux::db {

// kOk: the index is there, ours and of this program's schema. kFailed for an older one, with the remedy; otherwise as
// SessionStore::Open. Writes nothing.
Status RequireCurrentSchema(const std::filesystem::path& store);

// kNewerSchema for an index of schema `version`, which is newer than ours; names the copy of before that migration, if
// one that this program reads lies beside it.
Status NewerIndex(const std::filesystem::path& store, int64_t version);

}  // namespace stratalux::db
