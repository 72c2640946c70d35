// SPDX-License-Identifier: Apache-2.0
// The key of a session, for whoever reads what lies under it.
#pragma once

#include <filesystem>
#include <string>

#include "db/keys/key_store.h"

namespace stratalux::db {

// As FindKey(); kNotFound names the session and says how its key comes here.
[[nodiscard]] Result<SessionKey> FindKeyOf(const std::filesystem::path& store, const std::string& session_id,
                                           const KeyId& id);

}  // namespace stratalux::db
