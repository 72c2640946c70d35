// SPDX-License-Identifier: Apache-2.0
#include "db/keys/reader_key.h"

#include <algorithm>
#include <cstdlib>

#include <sodium.h>

#include "db/keys/rig_key.h"
#include "db/keys/secret_file.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr SecretFileKind kReaderKeyFile = {"stratalux reader key 1 x25519", "reader's key",
                                           "`stratalux-db key reader-init --out FILE` makes a reader's key",
                                           "keys sealed to it could not be opened with another key"};
constexpr const char* kPublicStart = "x25519-";
constexpr const char* kVariable = "STRATALUX_READER_KEY";
constexpr const char* kCredential = "reader.key";

static_assert(crypto_box_SECRETKEYBYTES == sizeof(SecretKey::bytes));
static_assert(crypto_box_PUBLICKEYBYTES == sizeof(ReaderPublicKey::bytes));

}  // namespace

ReaderId IdOf(const ReaderPublicKey& key) {
  const Digest digest = DigestOf(std::span<const uint8_t>(key.bytes));
  ReaderId id;
  std::copy_n(digest.begin(), id.bytes.size(), id.bytes.begin());
  return id;
}

std::string ToHex(const ReaderId& id) { return ToHex(std::span<const uint8_t>(id.bytes)); }
std::string ToText(const ReaderPublicKey& key) { return kPublicStart + ToHex(std::span<const uint8_t>(key.bytes)); }

std::optional<ReaderPublicKey> ReaderPublicKeyOf(const std::string& text) {
  ReaderPublicKey key;
  if (!text.starts_with(kPublicStart) || !FromHex(text.substr(std::string(kPublicStart).size()), key.bytes).ok())
    return std::nullopt;
  return key;
}

Result<ReaderPublicKey> ParseReaderPublicKey(const std::string& text) {
  if (const auto key = ReaderPublicKeyOf(text)) return *key;
  const std::string wanted = "a reader's public key, which begins with x25519- (`stratalux-db key reader-public`)";
  const auto file = ReadFile(text);
  if (!file.ok()) return Status::Usage("'" + text + "' is neither " + wanted + " nor a file that holds one");
  if (const auto key = ReaderPublicKeyOf(Unspaced(file->substr(0, file->find('\n'))))) return *key;
  return Status::Usage(text + ": its first line is not " + wanted);
}

ReaderKey::ReaderKey(std::shared_ptr<const SecretKey> secret) : secret_(std::move(secret)) {
  crypto_scalarmult_base(public_key_.bytes.data(), secret_->bytes.data());
}

ReaderKey ReaderKey::Passing() {
  auto secret = std::make_shared<SecretKey>();
  randombytes_buf(secret->bytes.data(), secret->bytes.size());
  return ReaderKey(std::move(secret));
}

Result<ReaderKey> ReaderKey::Create(const fs::path& file) {
  ReaderKey key = Passing();
  SLX_RETURN_IF_ERROR(PlaceSecretFile(file, kReaderKeyFile, key.secret()));
  return key;
}

Result<ReaderKey> ReaderKey::Read(const fs::path& file) {
  SLX_ASSIGN_OR_RETURN(auto secret, ReadSecretFile(file, kReaderKeyFile));
  return ReaderKey(std::move(secret));
}

Result<ReaderKey> ReaderKey::OfEnvironment() {
  if (const char* file = std::getenv(kVariable); file != nullptr && *file != '\0') {
    auto key = Read(file);
    return key.ok() ? std::move(key) : Result<ReaderKey>(key.status().WithContext(std::string("$") + kVariable));
  }
  const char* folder = std::getenv("CREDENTIALS_DIRECTORY");
  const fs::path credential = fs::path(folder == nullptr ? "" : folder) / kCredential;
  std::error_code error;
  if (folder == nullptr || !fs::exists(credential, error))
    return Status::NotFound(std::string("no reader's key was given ($") + kVariable + ")");
  SLX_ASSIGN_OR_RETURN(auto secret, ReadSecretFile(credential, kReaderKeyFile, SecretFileGuard::kFolder));
  return ReaderKey(std::move(secret));
}

}  // namespace stratalux::db
