// SPDX-License-Identifier: Apache-2.0
// The key of one session as a file (mode 0600), to be carried by hand to the machine that fits: pulls and backups never
// hold keys.
#pragma once

#include <filesystem>
#include <string>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

// Logged as "key export" and marked, so that `forget` deletes the file where it still lies. kUsage for a session that
// is not encrypted, and where FILE or FILE.new is there (but for what a killed export of the session left); kNotFound
// where its key is not here.
Status ExportKeyFile(const std::filesystem::path& store, const SessionRow& session, const std::filesystem::path& file);
// The session's id. kUsage for the key of a forgotten session; kIntegrity for a file that is none, for another key than
// the session's where it is listed, and where the store has other bytes under the key's id; kNewerSchema for one of a
// later version. Takes the write lock.
[[nodiscard]] Result<std::string> ImportKeyFile(const std::filesystem::path& store, const std::filesystem::path& file);

}  // namespace stratalux::db
