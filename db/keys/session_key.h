// SPDX-License-Identifier: Apache-2.0
// The key of a session, for whoever reads what lies under it.
#pragma once

#include <filesystem>
#include <string>

#include "db/keys/key_store.h"

namespace stratalux::db {

// As FindKey(); where it is not there, what this process was handed (db/keys/held_keys.h), else what is sealed beside
// the session to this program's reader (db/keys/reader_key.h), if it was given one. kNotFound names the session and
// says how its key comes here; kIntegrity for a sealed key that is damaged or another's; kFailed for a reader's key
// that others may read.
[[nodiscard]] Result<SessionKey> FindKeyOf(const std::filesystem::path& store, const std::string& session_id,
                                           const KeyId& id);

}  // namespace stratalux::db
