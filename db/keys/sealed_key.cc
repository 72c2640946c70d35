// SPDX-License-Identifier: Apache-2.0
#include "db/keys/sealed_key.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <optional>

#include <sodium.h>

#include "db/base/durable_file.h"
#include "db/keys/rig_key.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

static_assert(std::endian::native == std::endian::little, "the header is written as it lies in memory");

// The 48 bytes at the file's begin; then the session's id, the sealed bytes, the file's digest.
struct RawKeyHeader {
  char magic[8];
  uint32_t version;
  uint32_t session_bytes;
  uint8_t key_id[16];
  uint8_t reader_id[16];
};
static_assert(sizeof(RawKeyHeader) == 48, "no padding: its bytes are what is digested");

constexpr char kKeyMagic[8] = {'S', 'L', 'X', 'S', 'K', 'E', 'Y', '\0'};
constexpr uint32_t kMostSessionBytes = 128;
constexpr size_t kBoundBytes = sizeof(Digest), kOpenBytes = kBoundBytes + sizeof(SecretKey::bytes);
constexpr size_t kBoxBytes = kOpenBytes + crypto_box_SEALBYTES;
constexpr size_t kDigestBytes = 16;
constexpr int64_t kMostFileBytes = sizeof(RawKeyHeader) + kMostSessionBytes + kBoxBytes + kDigestBytes;
// Of what is read, also of a later version, which is then told from a foreign file.
constexpr int64_t kMostReadBytes = int64_t{64} << 10;
static_assert(kMostFileBytes < kMostReadBytes);
constexpr const char *kNameStart = "key-", *kNameEnd = ".sealed";

struct KeyFileParts {
  RawKeyHeader header{};
  std::string said;  // header and session
  std::string box;
  [[nodiscard]] std::string session() const { return said.substr(sizeof header); }
  [[nodiscard]] KeyId key() const {
    KeyId id{};
    std::copy(std::begin(header.key_id), std::end(header.key_id), id.begin());
    return id;
  }
  [[nodiscard]] ReaderId reader() const {
    ReaderId id;
    std::copy(std::begin(header.reader_id), std::end(header.reader_id), id.bytes.begin());
    return id;
  }
};

std::string DigestOfFile(const std::string& bytes) {
  return std::string(reinterpret_cast<const char*>(DigestOf(bytes).data()), kDigestBytes);
}

// What the sealed bytes are bound to.
Digest BoundDigest(const std::string& said, const ReaderPublicKey& reader) {
  return DigestOf(said + std::string(reinterpret_cast<const char*>(reader.bytes.data()), reader.bytes.size()));
}

Result<KeyFileParts> ReadParts(const fs::path& file) {
  SLX_ASSIGN_OR_RETURN(const std::string bytes, ReadSealedKeyBytes(file));
  const Status foreign = Status::Integrity(file.string() + " is not a sealed key");
  KeyFileParts parts;
  if (bytes.size() < sizeof kKeyMagic + sizeof parts.header.version ||
      std::memcmp(bytes.data(), kKeyMagic, sizeof kKeyMagic) != 0)
    return foreign;
  std::memcpy(&parts.header, bytes.data(), std::min(bytes.size(), sizeof parts.header));
  if (parts.header.version > kSealedKeyVersion)
    return Status(StatusCode::kNewerSchema, file.string() + ": version " + std::to_string(parts.header.version) +
                                                " of sealed keys, this program reads " +
                                                std::to_string(kSealedKeyVersion) + "; use a newer stratalux");
  const size_t said = sizeof parts.header + parts.header.session_bytes;
  const bool whole = parts.header.version == kSealedKeyVersion && parts.header.session_bytes <= kMostSessionBytes &&
                     bytes.size() == said + kBoxBytes + kDigestBytes &&
                     DigestOfFile(bytes.substr(0, said + kBoxBytes)) == bytes.substr(said + kBoxBytes);
  if (!whole)
    return Status::Integrity(
        file.string() +
        " was cut off or changed; run `stratalux-db key share` where the session was captured to seal"
        " its key again");
  parts.said = bytes.substr(0, said);
  parts.box = bytes.substr(said, kBoxBytes);
  return parts;
}

Status CheckParts(const fs::path& file, const KeyFileParts& parts, const std::string& session_id, const KeyId& key) {
  if (parts.session() != session_id)
    return Status::Integrity(file.string() + " is the sealed key of session " + parts.session() + ", not of " +
                             session_id);
  if (parts.key() != key)
    return Status::Integrity(file.string() + " is a sealed key with a different id from its session's");
  if (file.filename() != SealedKeyFile({}, parts.reader()).filename())
    return Status::Integrity(file.string() + " is sealed to reader " + ToHex(parts.reader()));
  return Status::Ok();
}

}  // namespace

fs::path SealedKeyFile(const fs::path& folder, const ReaderId& reader) {
  return folder / (kNameStart + ToHex(reader) + kNameEnd);
}

bool IsSealedKeyName(const std::string& name) {
  return name.starts_with(kNameStart) && (name.ends_with(kNameEnd) || name.ends_with(std::string(kNameEnd) + ".new"));
}

std::vector<fs::path> ListSealedKeys(const fs::path& folder) {
  std::vector<fs::path> files;
  std::error_code error;
  for (auto entry = fs::directory_iterator(folder, error); !error && entry != fs::end(entry); entry.increment(error))
    if (const std::string name = entry->path().filename().string(); IsSealedKeyName(name) && name.ends_with(kNameEnd))
      files.push_back(entry->path());
  std::sort(files.begin(), files.end());
  return files;
}

Result<std::string> ReadSealedKeyBytes(const fs::path& file) {
  std::error_code error;
  const auto type = fs::symlink_status(file, error).type();
  if (type == fs::file_type::not_found) return Status::NotFound(file.string() + " is not there");
  // A link, a pipe, or something larger than any is no sealed key.
  if (type != fs::file_type::regular) return Status::Integrity(file.string() + " is not a sealed key");
  const auto size = fs::file_size(file, error);
  if (!error && size > static_cast<uintmax_t>(kMostReadBytes))
    return Status::Integrity(file.string() + " is not a sealed key: it has " + std::to_string(size) +
                             " bytes, a sealed key has at most " + std::to_string(kMostReadBytes));
  return ReadFile(file, kMostReadBytes);
}

Status WriteSealedKey(const fs::path& folder, const std::string& session_id, const SessionKey& key,
                      const ReaderPublicKey& reader) {
  if (session_id.empty() || session_id.size() > kMostSessionBytes)
    return Status::Usage("'" + session_id + "' is not a session id");
  const ReaderId id = IdOf(reader);
  RawKeyHeader header{};
  std::memcpy(header.magic, kKeyMagic, sizeof kKeyMagic);
  header.version = kSealedKeyVersion;
  header.session_bytes = static_cast<uint32_t>(session_id.size());
  std::copy(key.id.begin(), key.id.end(), header.key_id);
  std::copy(id.bytes.begin(), id.bytes.end(), header.reader_id);
  std::string bytes = std::string(reinterpret_cast<const char*>(&header), sizeof header) + session_id;
  const Digest bound = BoundDigest(bytes, reader);
  LockedBytes<kOpenBytes> open;
  std::copy(bound.begin(), bound.end(), open.bytes.begin());
  std::copy(key.key->bytes.begin(), key.key->bytes.end(), open.bytes.begin() + kBoundBytes);
  std::string box(kBoxBytes, '\0');
  if (crypto_box_seal(reinterpret_cast<uint8_t*>(box.data()), open.bytes.data(), open.bytes.size(),
                      reader.bytes.data()) != 0)
    return Status::Usage(ToText(reader) + " is not a key that anything can be sealed to");
  bytes += box;
  return ReplaceFile(SealedKeyFile(folder, id), bytes + DigestOfFile(bytes));
}

Result<SealedKeyHeader> ReadSealedKeyHeader(const fs::path& file) {
  SLX_ASSIGN_OR_RETURN(const KeyFileParts parts, ReadParts(file));
  return SealedKeyHeader{parts.session(), parts.key(), parts.reader()};
}

Status CheckSealedKey(const fs::path& file, const std::string& session_id, const KeyId& key) {
  SLX_ASSIGN_OR_RETURN(const KeyFileParts parts, ReadParts(file));
  return CheckParts(file, parts, session_id, key);
}

Result<SessionKey> OpenSealedKey(const fs::path& folder, const std::string& session_id, const KeyId& key,
                                 const ReaderKey& reader) {
  const fs::path file = SealedKeyFile(folder, IdOf(reader.public_key()));
  SLX_ASSIGN_OR_RETURN(const KeyFileParts parts, ReadParts(file));
  SLX_RETURN_IF_ERROR(CheckParts(file, parts, session_id, key));
  LockedBytes<kOpenBytes> open;
  const Digest bound = BoundDigest(parts.said, reader.public_key());
  if (crypto_box_seal_open(open.bytes.data(), reinterpret_cast<const uint8_t*>(parts.box.data()), parts.box.size(),
                           reader.public_key().bytes.data(), reader.secret().bytes.data()) != 0 ||
      sodium_memcmp(open.bytes.data(), bound.data(), bound.size()) != 0)
    return Status::Integrity(
        file.string() +
        " cannot be opened with the reader's key as the key of this session: it was changed, or put"
        " there by someone else");
  auto secret = std::make_shared<SecretKey>();
  std::copy_n(open.bytes.begin() + kBoundBytes, secret->bytes.size(), secret->bytes.begin());
  return SessionKey{key, std::move(secret)};
}

Status WipeSealedKey(const fs::path& folder, const ReaderId& reader) {
  const fs::path file = SealedKeyFile(folder, reader);
  SLX_RETURN_IF_ERROR(WipeFile(file.string() + ".new"));
  std::error_code error;
  if (!fs::exists(fs::symlink_status(file, error))) return Status::Ok();
  SLX_RETURN_IF_ERROR(WipeFile(file));
  return SyncFolder(folder);
}

Status WipeSealedKeys(const fs::path& folder) {
  std::vector<fs::path> files;
  std::error_code error;
  for (auto entry = fs::directory_iterator(folder, error); !error && entry != fs::end(entry); entry.increment(error))
    if (IsSealedKeyName(entry->path().filename().string())) files.push_back(entry->path());
  for (const fs::path& file : files) SLX_RETURN_IF_ERROR(WipeFile(file));
  return files.empty() ? Status::Ok() : SyncFolder(folder);
}

}  // namespace stratalux::db
