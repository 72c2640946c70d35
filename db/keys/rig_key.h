// SPDX-License-Identifier: Apache-2.0
// The rig's key: Ed25519 of libsodium, by which an auditor tells sessions of this rig from forgeries. It lies in
// STORE/rig.key, mode 0600, in no manifest, pull, backup or export; only its public half leaves the rig.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>

#include "db/keys/key_store.h"
#include "shared/base/result.h"

namespace stratalux::db {

using PublicKey = std::array<uint8_t, 32>;
using Ed25519Signature = std::array<uint8_t, 64>;
using Digest = std::array<uint8_t, 32>;  // BLAKE2b-256

class RigKey {
 public:
  // kUsage where there is one: what it signed would no longer be its own.
  static Result<RigKey> Create(const std::filesystem::path& store);
  // kNotFound with the remedy; kFailed where others may read the file; kIntegrity where it is damaged.
  static Result<RigKey> Read(const std::filesystem::path& store);

  [[nodiscard]] const PublicKey& public_key() const { return public_key_; }
  [[nodiscard]] Ed25519Signature Sign(const std::string& message) const;

 private:
  RigKey() = default;
  static Result<RigKey> FromSeed(std::shared_ptr<const SecretKey> seed);
  std::shared_ptr<const SecretKey> seed_;
  PublicKey public_key_{};
};

[[nodiscard]] std::filesystem::path RigKeyFile(const std::filesystem::path& store);
[[nodiscard]] bool IsSignedBy(const std::string& message, const Ed25519Signature& signature, const PublicKey& key);

[[nodiscard]] Digest DigestOf(std::span<const uint8_t> bytes);
[[nodiscard]] Digest DigestOf(const std::string& bytes);

[[nodiscard]] std::string ToHex(std::span<const uint8_t> bytes);
// kUsage for anything but 2 * bytes.size() hex digits.
Status FromHex(const std::string& text, std::span<uint8_t> bytes);
// Of 64 hex digits, or of the first line of the file that `text` names.
[[nodiscard]] Result<PublicKey> ParsePublicKey(const std::string& text);
// For people: 16 hex digits in groups of four, of the key's BLAKE2b-256.
[[nodiscard]] std::string Fingerprint(const PublicKey& key);

}  // namespace stratalux::db
