// SPDX-License-Identifier: Apache-2.0
// STORE/keys.sqlite: one random key for each encrypted session, and one for each visitor with a session, by which the
// ledger names visitors; in a file of its own (mode 0600), so that it stays out of manifests, pulls and backups and so
// that destroying a key destroys what was written with it.
//
// Every write is followed by a wipe of SQLite's journal, which holds the page as it was before. Callers of CreateKey,
// ImportKey, DestroyKey, NameVisitor and DestroyVisitorKey hold the store's write lock: nobody else then has a journal
// there.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "db/keys/locked_bytes.h"
#include "shared/base/result.h"

namespace stratalux::db {

using KeyId = std::array<uint8_t, 16>;

struct SessionKey {
  KeyId id{};
  std::shared_ptr<const SecretKey> key;
};

[[nodiscard]] std::string ToHex(const KeyId& id);
[[nodiscard]] std::filesystem::path KeyFile(const std::filesystem::path& store);

// A fresh random key, safe on the disk when this returns. Makes keys.sqlite when missing.
[[nodiscard]] Result<SessionKey> CreateKey(const std::filesystem::path& store);
// kNotFound where the key (or keys.sqlite) is not there or may not be read; kIntegrity for a damaged or foreign file.
[[nodiscard]] Result<SessionKey> FindKey(const std::filesystem::path& store, const KeyId& id);
// Stores a key that came from another machine; kOk when it is there already, kIntegrity where its id has other bytes.
Status ImportKey(const std::filesystem::path& store, const SessionKey& key);
// Overwrites and removes the key; kOk when it is not there.
Status DestroyKey(const std::filesystem::path& store, const KeyId& id);
[[nodiscard]] Result<std::vector<KeyId>> ListKeys(const std::filesystem::path& store);

// HMAC-SHA512-256 of the pseudonym under the visitor's own random key, 64 hex digits: the name that a visitor has in
// the ledger. Without the key nobody can tell whose it was, nor try pseudonyms against it. The first makes the key
// where there is none, the second has none (kNotFound).
[[nodiscard]] Result<std::string> NameVisitor(const std::filesystem::path& store, const std::string& pseudonym);
[[nodiscard]] Result<std::string> FindVisitorName(const std::filesystem::path& store, const std::string& pseudonym);
// Overwrites and removes the key, and the pseudonym with it; kOk when it is not there.
Status DestroyVisitorKey(const std::filesystem::path& store, const std::string& pseudonym);

}  // namespace stratalux::db
