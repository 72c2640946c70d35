// SPDX-License-Identifier: Apache-2.0
// STORE/readers/<id>.pub: the readers that a store seals its sessions' keys to (db/keys/reader_key.h).
#pragma once

#include <filesystem>
#include <vector>

#include "db/keys/key_store.h"
#include "db/keys/reader_key.h"

namespace stratalux::db {

inline constexpr const char* kReadersFolder = "readers";

// By id. kIntegrity names a file that is none: who cannot be sealed to is not passed over.
[[nodiscard]] Result<std::vector<ReaderPublicKey>> ListReaders(const std::filesystem::path& store);
// kOk where it is there already. The caller holds the store's write lock; so of the next.
Status AddReader(const std::filesystem::path& store, const ReaderPublicKey& reader);
// False where it is not there.
Result<bool> RemoveReader(const std::filesystem::path& store, const ReaderId& reader);

// The key of a session that begins, to each reader of the store.
Status SealToReaders(const std::filesystem::path& store, const std::string& session_id, const SessionKey& key);

}  // namespace stratalux::db
