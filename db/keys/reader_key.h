// SPDX-License-Identifier: Apache-2.0
// A reader: whoever fits encrypted sessions on another machine than the one that captured them. It has a key pair
// (X25519). Stores hold the public half and seal each session's key to it (db/keys/sealed_key.h); the private one lies
// in a file (mode 0600) of the machine that fits, in no store.
#pragma once

#include <array>
#include <compare>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "db/keys/locked_bytes.h"
#include "shared/base/result.h"

namespace stratalux::db {

struct ReaderPublicKey {
  std::array<uint8_t, 32> bytes{};
  auto operator<=>(const ReaderPublicKey&) const = default;
};

// The first 16 bytes of BLAKE2b-256 of the public key: names files, and the reader to people.
struct ReaderId {
  std::array<uint8_t, 16> bytes{};
  auto operator<=>(const ReaderId&) const = default;
};

[[nodiscard]] ReaderId IdOf(const ReaderPublicKey& key);
[[nodiscard]] std::string ToHex(const ReaderId& id);
// "x25519-" and 64 hexadecimal digits: no key that signs passes for one to seal to.
[[nodiscard]] std::string ToText(const ReaderPublicKey& key);
// That alone: nullopt for any other text.
[[nodiscard]] std::optional<ReaderPublicKey> ReaderPublicKeyOf(const std::string& text);
// That, or a file whose first line is that.
[[nodiscard]] Result<ReaderPublicKey> ParseReaderPublicKey(const std::string& text);

class ReaderKey {
 public:
  // kUsage where something is there: what is sealed to it could not be read any more.
  static Result<ReaderKey> Create(const std::filesystem::path& file);
  // kNotFound; kFailed where others may read the file; kIntegrity where it is damaged.
  static Result<ReaderKey> Read(const std::filesystem::path& file);
  // Of the file that $STRATALUX_READER_KEY names, else of systemd's credential `reader.key`
  // ($CREDENTIALS_DIRECTORY). kNotFound where this program was given none.
  static Result<ReaderKey> OfEnvironment();
  // A new one in this process's memory alone: it ends with it, and so does what was sealed to it.
  static ReaderKey Passing();

  [[nodiscard]] const ReaderPublicKey& public_key() const { return public_key_; }
  [[nodiscard]] const SecretKey& secret() const { return *secret_; }

 private:
  explicit ReaderKey(std::shared_ptr<const SecretKey> secret);
  std::shared_ptr<const SecretKey> secret_;
  ReaderPublicKey public_key_;
};

}  // namespace stratalux::db
