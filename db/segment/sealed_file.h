// SPDX-License-Identifier: Apache-2.0
// Files of an encrypted session that are no frames, such as the maps of its fits: encrypted and authenticated under the
// session's key, each bound to its session and its place (docs/file-formats.md, "Sealed files").
//
// Pieces of 1 MiB by XChaCha20-Poly1305, as STREAM has it (Hoang, Reyhanitabar, Rogaway, Vizar 2015): the nonce of a
// piece is the file's own 16 bytes and the number of the piece. Those 16 bytes are keyed BLAKE2b of session, place and
// plain bytes (a synthetic nonce: Rogaway, Shrimpton 2006), so that the same file at the same place has the same bytes
// whoever seals it, and no nonce serves two different files. Both keys are derived from the session's by crypto_kdf:
// frames share neither. The header, which tells the length, is authenticated with every piece.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <set>
#include <string>

#include "db/keys/key_store.h"

namespace stratalux::db {

inline constexpr uint32_t kSealedFileVersion = 1;
inline constexpr uint64_t kSealedPieceBytes = uint64_t{1} << 20;  // of plain bytes; the last piece may be shorter

// What a sealed file says of itself, to be read without a key. Nothing of it is proven before the file is opened.
struct SealedHeader {
  uint32_t version = kSealedFileVersion;
  std::string key_id;  // 32 hex digits
  std::string
      place;  // within the session's folder, where it was sealed for, such as "artifacts/shape-KEY/position.exr"
  uint64_t plain_bytes = 0;
};

// nullopt: a file of another kind. kIntegrity: cut off within its header; kNewerSchema.
[[nodiscard]] Result<std::optional<SealedHeader>> ReadSealedHeader(const std::filesystem::path& file);

// The seal of one session. Looks for the session's key when it first needs it. Thread-bound.
class FileSeal {
 public:
  FileSeal() = default;  // of a session that is not encrypted
  // `key_id`: 32 hex digits, or empty where the session is not encrypted.
  FileSeal(std::filesystem::path store, std::string session_id, std::string key_id);

  [[nodiscard]] bool active() const { return !key_id_.empty(); }
  [[nodiscard]] const std::string& key_id() const { return key_id_; }
  // kNotFound, with the remedy, where the key is not here.
  Status RequireKey();

  // All that follows: of an active seal only.
  // `plain` as a new file `sealed`, readable by account and group; not synced. `place` as SealedHeader has it.
  Status Seal(const std::filesystem::path& plain, const std::string& place, const std::filesystem::path& sealed);
  // The plain bytes, into the file at `into`, which is emptied first. kNotFound without the key; kIntegrity where the
  // file is not what was sealed, belongs to another session or to none of `places`, or is plain: what then stands at
  // `into` is nothing.
  Status Open(const std::filesystem::path& sealed, const std::set<std::string>& places,
              const std::filesystem::path& into);
  // As Open, and writes nothing: whether every byte is what was sealed.
  Status Check(const std::filesystem::path& sealed, const std::set<std::string>& places);
  // Without the key: whether the header says that the file is sealed under this key, for one of the places, and has its
  // length. kIntegrity as above.
  [[nodiscard]] Status CheckHeader(const std::filesystem::path& sealed, const std::set<std::string>& places) const;

 private:
  struct Keys;
  std::filesystem::path store_;
  std::string session_id_, key_id_;
  std::shared_ptr<const Keys> keys_;
};

}  // namespace stratalux::db
