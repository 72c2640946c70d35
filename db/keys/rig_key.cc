// SPDX-License-Identifier: Apache-2.0
#include "db/keys/rig_key.h"

#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "shared/base/read_file.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr const char* kFirstLine = "stratalux rig key 1 ed25519";

static_assert(crypto_sign_PUBLICKEYBYTES == sizeof(PublicKey) && crypto_sign_BYTES == sizeof(Ed25519Signature));
static_assert(crypto_sign_SEEDBYTES == sizeof(SecretKey::bytes));

Status Write(const fs::path& file, const std::string& text) {
  const int fd = open(file.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_NOFOLLOW | O_CLOEXEC, 0600);
  if (fd < 0) return Status::Failed("cannot write " + file.string() + ": " + std::strerror(errno));
  Status written = fchmod(fd, 0600) == 0 ? WriteAll(fd, text.data(), text.size(), file.string())
                                         : Status::Failed("cannot make " + file.string() + " private");
  if (written.ok() && fsync(fd) != 0)
    written = Status::Failed("cannot sync " + file.string() + ": " + std::strerror(errno));
  close(fd);
  return written;
}

// Whole under its own name, or not there; never over another.
Status Place(const fs::path& file, const std::string& text) {
  const fs::path beside = file.string() + ".new";
  Status placed = Write(beside, text);
  if (placed.ok() && link(beside.c_str(), file.c_str()) != 0)
    placed = errno == EEXIST ? Status::Usage(file.string() +
                                             " is there already; another key would not be the one that"
                                             " the auditor knows")
                             : Status::Failed("cannot create " + file.string() + ": " + std::strerror(errno));
  unlink(beside.c_str());
  const fs::path folder = file.parent_path();
  if (placed.ok()) placed = SyncFolder(folder.empty() ? "." : folder);
  return placed;
}

std::string Unspaced(std::string text) {
  while (!text.empty() && (text.back() == '\n' || text.back() == '\r' || text.back() == ' ')) text.pop_back();
  return text;
}

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
  std::string text = std::string(kFirstLine) + "\n" + ToHex(seed->bytes) + "\n";
  const Status placed = Place(RigKeyFile(store), text);
  sodium_memzero(text.data(), text.size());
  SLX_RETURN_IF_ERROR(placed);
  return FromSeed(std::move(seed));
}

Result<RigKey> RigKey::Read(const fs::path& store) {
  const fs::path file = RigKeyFile(store);
  const UniqueFd fd(open(file.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC));
  if (fd.get() < 0 && errno == ENOENT)
    return Status::NotFound(file.string() + " is not there: `stratalux-db key sign-init` makes the rig's key");
  if (fd.get() < 0) return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno));
  struct stat info {};
  if (fstat(fd.get(), &info) != 0 || (info.st_mode & 077) != 0)
    return Status::Failed(file.string() +
                          " can be read by others: `chmod 600`, and think whether it still is a secret");
  char text[128] = {};
  const ssize_t size = read(fd.get(), text, sizeof text - 1);
  if (size < 0) return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno));
  const std::string start = std::string(kFirstLine) + "\n";
  auto seed = std::make_shared<SecretKey>();
  const bool ours = std::strncmp(text, start.c_str(), start.size()) == 0;
  const bool whole = ours && FromHex(Unspaced(text + start.size()), seed->bytes).ok();
  sodium_memzero(text, sizeof text);
  if (!whole) return Status::Integrity(file.string() + " is no rig key, or damaged; restore it from your own copy");
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
    return Status::Usage(text + ": its first line is " + parsed.message() + " (`stratalux-db key public` prints them)");
  return key;
}

std::string Fingerprint(const PublicKey& key) {
  const std::string hex = ToHex(std::span<const uint8_t>(DigestOf(key)).first(8));
  return hex.substr(0, 4) + "-" + hex.substr(4, 4) + "-" + hex.substr(8, 4) + "-" + hex.substr(12, 4);
}

}  // namespace stratalux::db
