// SPDX-License-Identifier: Apache-2.0
// The key of a session, sealed to a reader's public key and kept beside the session, so that a pull carries it
// (docs/file-formats.md, "Sealed keys"). Whoever sealed it cannot open it again; the reader's private key does.
//
// The sealed bytes hold a digest of all that stands before them, the session's id and the key's included, and of the
// reader's public key: a file of another session or reader does not open. Everybody who knows the public key can seal
// something to it: a key that is not the session's opens none of its frames.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/keys/key_store.h"
#include "db/keys/reader_key.h"

namespace stratalux::db {

inline constexpr uint32_t kSealedKeyVersion = 1;

// What the file says of itself, to be read without a key.
struct SealedKeyHeader {
  std::string session;
  KeyId key{};
  ReaderId reader;
};

// key-<reader>.sealed, in the folder of a session.
[[nodiscard]] std::filesystem::path SealedKeyFile(const std::filesystem::path& session_folder, const ReaderId& reader);
// By its name; also what a killed program left beside one that it was writing.
[[nodiscard]] bool IsSealedKeyName(const std::string& name);
// Paths, by name; without what is left beside.
[[nodiscard]] std::vector<std::filesystem::path> ListSealedKeys(const std::filesystem::path& session_folder);

// Whole under its name, or as it was. kUsage for a public key that nothing can be sealed to.
Status WriteSealedKey(const std::filesystem::path& session_folder, const std::string& session_id, const SessionKey& key,
                      const ReaderPublicKey& reader);
// All of the file, unchecked. kNotFound; kIntegrity for what is too large for one, of which nothing is read, or no
// file.
[[nodiscard]] Result<std::string> ReadSealedKeyBytes(const std::filesystem::path& file);
// kNotFound; kIntegrity for a file that is cut or damaged, as its own digest tells; kNewerSchema.
[[nodiscard]] Result<SealedKeyHeader> ReadSealedKeyHeader(const std::filesystem::path& file);
// kOk where `file` is what its name and place say: of this session, key and reader.
Status CheckSealedKey(const std::filesystem::path& file, const std::string& session_id, const KeyId& key);
// As above, and kIntegrity where the file does not open with the reader's key.
[[nodiscard]] Result<SessionKey> OpenSealedKey(const std::filesystem::path& session_folder,
                                               const std::string& session_id, const KeyId& key,
                                               const ReaderKey& reader);
// Overwrites and removes all of a session, or that of one reader; kOk where there is none.
Status WipeSealedKeys(const std::filesystem::path& session_folder);
Status WipeSealedKey(const std::filesystem::path& session_folder, const ReaderId& reader);

}  // namespace stratalux::db
