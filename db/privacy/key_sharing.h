// SPDX-License-Identifier: Apache-2.0
// Who may read a store's encrypted sessions elsewhere: each session's key, sealed to the public key of a reader
// (db/keys/reader_key.h), lies beside the session and goes with it where a pull takes it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "db/keys/reader_key.h"
#include "shared/base/result.h"

namespace stratalux::db {

struct SharedKeys {
  int64_t readers = 0, sessions = 0;    // of the store; that are encrypted
  int64_t sealed = 0;                   // files that this call made
  std::vector<std::string> not_sealed;  // sessions whose key is not in this store, and why
};

// Adds a reader (nullopt: none), so that sessions which begin from now on are sealed to it, and seals the key of each
// session that is here to each reader. What is sealed already stays; what is damaged is made anew. Given again it goes
// on. kBusy while a session is written: then as far as it came. kUsage where the store has no reader.
[[nodiscard]] Result<SharedKeys> ShareKeys(const std::filesystem::path& store,
                                           const std::optional<ReaderPublicKey>& reader);

// Removes a reader and what is sealed to it here; also what an earlier call left that was broken off, and what lies of
// it in sessions from elsewhere. Copies that a pull has taken stay where they are. Returns how many files went;
// kNotFound where there is neither. kBusy while a session is written.
[[nodiscard]] Result<int64_t> UnshareKeys(const std::filesystem::path& store, const ReaderId& reader);

struct ReaderRow {
  ReaderId id;
  std::optional<ReaderPublicKey> key;  // nullopt: no reader of this store, but something is sealed to it
  int64_t sealed = 0;                  // sessions whose key is
};
// By id.
[[nodiscard]] Result<std::vector<ReaderRow>> ListSharing(const std::filesystem::path& store);
// The one whose id begins with `text`, or whose public key it is or names; also one that is no reader of this store any
// more. kNotFound, kUsage where it is ambiguous.
[[nodiscard]] Result<ReaderId> FindReader(const std::filesystem::path& store, const std::string& text);

}  // namespace stratalux::db
