// SPDX-License-Identifier: Apache-2.0
#include "db/keys/rig_key.h"

#include <sodium.h>

#include "db/keys/secret_file.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr SecretFileKind kRigKeyFile = {"stratalux rig key 1 ed25519", "rig key",
                                        "`stratalux-db key sign-init` makes the rig's key",
                                        "another key would not be the one that the auditor knows"};

static_assert(crypto_sign_PUBLICKEYBYTES == sizeof(PublicKey) && crypto_sign_BYTES == sizeof(Ed25519Signature));
static_assert(crypto_sign_SEEDBYTES == sizeof(SecretKey::bytes));

}  // namespace

fs::path RigKeyFile(const fs::path& store) { return store / "rig.key"; }

Result<RigKey> RigKey::FromSeed(std::shared_ptr<const SecretKey> seed) {
  if (sodium_init() < 0) return Status::Failed("libsodium finds no source of random numbers");
  RigKey key;
  std::array<uint8_t, crypto_sign_SECRETKEYBYTES> secret;
  crypto_sign_seed_keypair(key.public_key_.data(), secret.data(), seed->bytes.data());
  sodium_memzero(secret.data(), secret.size());
  key.seed_ = std::move(seed);
  return key;
}

Result<RigKey> RigKey::Create(const fs::path& store) {
  if (sodium_init() < 0) return Status::Failed("libsodium finds no source of random numbers");
  auto seed = std::make_shared<SecretKey>();
  randombytes_buf(seed->bytes.data(), seed->bytes.size());
  SLX_RETURN_IF_ERROR(PlaceSecretFile(RigKeyFile(store), kRigKeyFile, *seed));
  return FromSeed(std::move(seed));
}

Result<RigKey> RigKey::Read(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(auto seed, ReadSecretFile(RigKeyFile(store), kRigKeyFile));
  return FromSeed(std::move(seed));
}

Ed25519Signature RigKey::Sign(const std::string& message) const {
  std::array<uint8_t, crypto_sign_SECRETKEYBYTES> secret;
  PublicKey unused;
  crypto_sign_seed_keypair(unused.data(), secret.data(), seed_->bytes.data());
  Ed25519Signature signature;
  crypto_sign_detached(signature.data(), nullptr, reinterpret_cast<const uint8_t*>(message.data()), message.size(),
                       secret.data());
  sodium_memzero(secret.data(), secret.size());
  return signature;
}

bool IsSignedBy(const std::string& message, const Ed25519Signature& signature, const PublicKey& key) {
  return sodium_init() >= 0 &&
         crypto_sign_verify_detached(signature.data(), reinterpret_cast<const uint8_t*>(message.data()), message.size(),
                                     key.data()) == 0;
}

Digest DigestOf(std::span<const uint8_t> bytes) {
  Digest digest;
  crypto_generichash(digest.data(), digest.size(), bytes.data(), bytes.size(), nullptr, 0);
  return digest;
}

Digest DigestOf(const std::string& bytes) {
  return DigestOf(std::span(reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()));
}

std::string ToHex(std::span<const uint8_t> bytes) {
  std::string text(2 * bytes.size() + 1, '\0');
  sodium_bin2hex(text.data(), text.size(), bytes.data(), bytes.size());
  text.pop_back();
  return text;
}

Status FromHex(const std::string& text, std::span<uint8_t> bytes) {
  size_t size = 0;
  if (text.size() == 2 * bytes.size() &&
      sodium_hex2bin(bytes.data(), bytes.size(), text.data(), text.size(), nullptr, &size, nullptr) == 0 &&
      size == bytes.size())
    return Status::Ok();
  return Status::Usage("not " + std::to_string(2 * bytes.size()) + " hexadecimal digits");
}

Result<PublicKey> ParsePublicKey(const std::string& text) {
  PublicKey key{};
  if (FromHex(text, key).ok()) return key;
  const auto file = ReadFile(text);
  if (!file.ok())
    return Status::Usage("'" + text + "' is neither a public key of 64 hexadecimal digits nor a file that holds one");
  const std::string line = Unspaced(file->substr(0, file->find('\n')));
  if (const Status parsed = FromHex(line, key); !parsed.ok())
    return Status::Usage(text + ": its first line is " + parsed.message() + " (`stratalux-db key public` prints one)");
  return key;
}

std::string Fingerprint(const PublicKey& key) {
  const std::string hex = ToHex(std::span<const uint8_t>(DigestOf(key)).first(8));
  return hex.substr(0, 4) + "-" + hex.substr(4, 4) + "-" + hex.substr(8, 4) + "-" + hex.substr(12, 4);
}

}  // namespace stratalux::db
