// SPDX-License-Identifier: Apache-2.0
#include "db/segment/sealed_file.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <span>
#include <vector>

#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/keys/session_key.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

static_assert(std::endian::native == std::endian::little, "the header is written as it lies in memory");
static_assert(crypto_kdf_KEYBYTES == sizeof(SecretKey::bytes));

// The 64 bytes at the file's begin; then place_bytes of the place, then the pieces.
struct RawHeader {
  char magic[8];
  uint32_t version;
  uint32_t place_bytes;
  uint8_t key_id[16];
  uint8_t nonce[16];  // of the file; a piece's is these and its number
  uint64_t plain_bytes;
  uint64_t reserved;  // 0
};
static_assert(sizeof(RawHeader) == 64, "no padding: its bytes are what is authenticated");

constexpr char kMagic[8] = {'S', 'L', 'X', 'S', 'E', 'A', 'L', '\0'};
constexpr uint32_t kMostPlaceBytes = 1024;
constexpr size_t kTagBytes = crypto_aead_xchacha20poly1305_ietf_ABYTES;
constexpr char kDerivation[crypto_kdf_CONTEXTBYTES + 1] = "SLXfiles";
constexpr uint64_t kPieceKey = 1, kNonceKey = 2;  // of that derivation

uint64_t PiecesOf(uint64_t plain_bytes) {
  return std::max<uint64_t>(1, (plain_bytes + kSealedPieceBytes - 1) / kSealedPieceBytes);
}
uint64_t StoredBytes(const RawHeader& header) {
  return sizeof(RawHeader) + header.place_bytes + header.plain_bytes + PiecesOf(header.plain_bytes) * kTagBytes;
}

Status Cannot(const std::string& what, const fs::path& file) {
  return Status::Failed("cannot " + what + " " + file.string() + ": " + std::strerror(errno));
}

// As many bytes as there are, up to bytes.size().
Result<size_t> Fill(int fd, std::span<uint8_t> bytes, const fs::path& file) {
  size_t filled = 0;
  while (filled < bytes.size()) {
    const ssize_t count = read(fd, bytes.data() + filled, bytes.size() - filled);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return Cannot("read", file);
    if (count == 0) break;
    filled += static_cast<size_t>(count);
  }
  return filled;
}

std::array<uint8_t, crypto_aead_xchacha20poly1305_ietf_NPUBBYTES> NonceOf(const RawHeader& header, uint64_t piece) {
  std::array<uint8_t, crypto_aead_xchacha20poly1305_ietf_NPUBBYTES> nonce{};
  static_assert(sizeof header.nonce + sizeof piece == sizeof nonce);
  std::memcpy(nonce.data(), header.nonce, sizeof header.nonce);
  std::memcpy(nonce.data() + sizeof header.nonce, &piece, sizeof piece);
  return nonce;
}

// The header, the place, the session.
std::string BoundTo(const RawHeader& header, const std::string& place, const std::string& session_id) {
  return std::string(reinterpret_cast<const char*>(&header), sizeof header) + place + session_id;
}
const uint8_t* BytesOf(const std::string& text) { return reinterpret_cast<const uint8_t*>(text.data()); }

struct OpenSealed {
  UniqueFd fd;  // behind header and place
  RawHeader header{};
  std::string place;
};

// nullopt as ReadSealedHeader.
Result<std::optional<OpenSealed>> OpenIfSealed(const fs::path& file) {
  OpenSealed sealed{UniqueFd(open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW)), {}, {}};
  if (!sealed.fd.ok()) return Cannot("read", file);
  const auto header = std::span(reinterpret_cast<uint8_t*>(&sealed.header), sizeof sealed.header);
  SLX_ASSIGN_OR_RETURN(const size_t there, Fill(sealed.fd.get(), header, file));
  if (there < sizeof kMagic || std::memcmp(sealed.header.magic, kMagic, sizeof kMagic) != 0)
    return std::optional<OpenSealed>();
  const Status cut = Status::Integrity(file.string() + " is cut off within the header of a sealed file");
  if (there < sizeof sealed.header) return cut;
  if (sealed.header.version != kSealedFileVersion)
    return Status(StatusCode::kNewerSchema, file.string() + ": version " + std::to_string(sealed.header.version) +
                                                " of sealed files, this program reads " +
                                                std::to_string(kSealedFileVersion) + "; use a newer stratalux");
  if (sealed.header.place_bytes > kMostPlaceBytes)
    return Status::Integrity(file.string() + ": the header of the sealed file is damaged");
  sealed.place.resize(sealed.header.place_bytes);
  const auto place = std::span(reinterpret_cast<uint8_t*>(sealed.place.data()), sealed.place.size());
  SLX_ASSIGN_OR_RETURN(const size_t named, Fill(sealed.fd.get(), place, file));
  if (named < place.size()) return cut;
  return std::optional(std::move(sealed));
}

std::string KeyIdText(const RawHeader& header) {
  KeyId id{};
  std::copy(std::begin(header.key_id), std::end(header.key_id), id.begin());
  return ToHex(id);
}

// The stretches of an open file of `bytes` bytes in turn, of a piece at most; an empty file has one. kFailed where it
// has fewer.
template <typename Use>
Status ForEachPiece(int fd, uint64_t bytes, const fs::path& file, const Use& use) {
  std::vector<uint8_t> piece(std::min(bytes, kSealedPieceBytes));
  for (uint64_t i = 0; i < PiecesOf(bytes); ++i) {
    const auto part = std::span(piece).first(std::min(kSealedPieceBytes, bytes - i * kSealedPieceBytes));
    SLX_ASSIGN_OR_RETURN(const size_t count, Fill(fd, part, file));
    if (count < part.size()) return Status::Failed(file.string() + " became shorter while it was sealed");
    SLX_RETURN_IF_ERROR(use(i, std::span<const uint8_t>(part)));
  }
  return Status::Ok();
}

}  // namespace

struct FileSeal::Keys {
  SecretKey piece, nonce;
};

Result<std::optional<SealedHeader>> ReadSealedHeader(const fs::path& file) {
  SLX_ASSIGN_OR_RETURN(const auto sealed, OpenIfSealed(file));
  if (!sealed) return std::optional<SealedHeader>();
  const RawHeader& header = sealed->header;
  return std::optional(SealedHeader{header.version, KeyIdText(header), sealed->place, header.plain_bytes});
}

FileSeal::FileSeal(fs::path store, std::string session_id, std::string key_id)
    : store_(std::move(store)), session_id_(std::move(session_id)), key_id_(std::move(key_id)) {}

Status FileSeal::RequireKey() {
  if (keys_ != nullptr || !active()) return Status::Ok();
  if (sodium_init() < 0) return Status::Failed("libsodium finds no source of random numbers");
  KeyId id{};
  if (sodium_hex2bin(id.data(), id.size(), key_id_.data(), key_id_.size(), nullptr, nullptr, nullptr) != 0)
    return Status::Integrity("session " + session_id_ + ": '" + key_id_ + "' is not a key id");
  SLX_ASSIGN_OR_RETURN(const SessionKey session, FindKeyOf(store_, session_id_, id));
  auto keys = std::make_shared<Keys>();
  for (const auto& [number, key] : {std::pair(kPieceKey, &keys->piece), {kNonceKey, &keys->nonce}})
    crypto_kdf_derive_from_key(key->bytes.data(), key->bytes.size(), number, kDerivation, session.key->bytes.data());
  keys_ = std::move(keys);
  return Status::Ok();
}

Status FileSeal::Seal(const fs::path& plain, const std::string& place, const fs::path& sealed) {
  SLX_RETURN_IF_ERROR(RequireKey());
  if (place.empty() || place.size() > kMostPlaceBytes)
    return Status::Usage("'" + place + "' is not the place of a file of session " + session_id_);
  const UniqueFd from(open(plain.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
  struct stat facts {};
  if (!from.ok() || fstat(from.get(), &facts) != 0) return Cannot("read", plain);
  RawHeader header{};
  std::memcpy(header.magic, kMagic, sizeof kMagic);
  header.version = kSealedFileVersion;
  header.place_bytes = static_cast<uint32_t>(place.size());
  sodium_hex2bin(header.key_id, sizeof header.key_id, key_id_.data(), key_id_.size(), nullptr, nullptr, nullptr);
  header.plain_bytes = static_cast<uint64_t>(facts.st_size);

  // The nonce: of all that the file says and of all that it holds.
  crypto_generichash_state hash;
  crypto_generichash_init(&hash, keys_->nonce.bytes.data(), keys_->nonce.bytes.size(), sizeof header.nonce);
  const std::string said = BoundTo(header, place, session_id_);
  crypto_generichash_update(&hash, BytesOf(said), said.size());
  SLX_RETURN_IF_ERROR(ForEachPiece(from.get(), header.plain_bytes, plain, [&](uint64_t, std::span<const uint8_t> part) {
    crypto_generichash_update(&hash, part.data(), part.size());
    return Status::Ok();
  }));
  crypto_generichash_final(&hash, header.nonce, sizeof header.nonce);
  if (lseek(from.get(), 0, SEEK_SET) != 0) return Cannot("read", plain);

  const UniqueFd to(open(sealed.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0640));
  if (!to.ok()) return Cannot("create", sealed);
  const std::string data = BoundTo(header, place, session_id_);
  SLX_RETURN_IF_ERROR(WriteAll(to.get(), data.data(), sizeof header + place.size(), sealed.string()));
  std::vector<uint8_t> stored(std::min(header.plain_bytes, kSealedPieceBytes) + kTagBytes);
  return ForEachPiece(from.get(), header.plain_bytes, plain, [&](uint64_t piece, std::span<const uint8_t> part) {
    unsigned long long bytes = 0;
    crypto_aead_xchacha20poly1305_ietf_encrypt(stored.data(), &bytes, part.data(), part.size(), BytesOf(data),
                                               data.size(), nullptr, NonceOf(header, piece).data(),
                                               keys_->piece.bytes.data());
    return WriteAll(to.get(), stored.data(), bytes, sealed.string());
  });
}

namespace {

Status CheckSaid(const OpenSealed& sealed, const fs::path& file, const std::string& key_id,
                 const std::set<std::string>& places) {
  if (KeyIdText(sealed.header) != key_id)
    return Status::Integrity(file.string() +
                             " is sealed with a key other than its session's: it is another session's file");
  if (!places.contains(sealed.place))
    return Status::Integrity(file.string() + " was sealed as " + sealed.place + ": it was put there by someone else");
  struct stat facts {};
  if (fstat(sealed.fd.get(), &facts) != 0) return Cannot("read", file);
  // A length of 2^64 would overflow into a small one.
  const auto there = static_cast<uint64_t>(facts.st_size);
  if (sealed.header.plain_bytes > there || StoredBytes(sealed.header) != there)
    return Status::Integrity(file.string() + " has " + std::to_string(there) +
                             " bytes, not as many as its header says; it was cut off or changed");
  return Status::Ok();
}

Result<OpenSealed> OpenSealedFile(const fs::path& file, const std::string& key_id,
                                  const std::set<std::string>& places) {
  SLX_ASSIGN_OR_RETURN(auto sealed, OpenIfSealed(file));
  if (!sealed) return Status::Integrity(file.string() + " is a plain file of an encrypted session");
  SLX_RETURN_IF_ERROR(CheckSaid(*sealed, file, key_id, places));
  return std::move(*sealed);
}

// The plain bytes of each piece in turn. kIntegrity where one is not what was sealed.
template <typename Use>
Status OpenPieces(const OpenSealed& sealed, const fs::path& file, const std::string& session_id, const SecretKey& key,
                  const Use& use) {
  const std::string data = BoundTo(sealed.header, sealed.place, session_id);
  const uint64_t bytes = sealed.header.plain_bytes;
  std::vector<uint8_t> stored(std::min(bytes, kSealedPieceBytes) + kTagBytes), plain(stored.size() - kTagBytes);
  for (uint64_t piece = 0; piece < PiecesOf(bytes); ++piece) {
    const uint64_t size = std::min(kSealedPieceBytes, bytes - piece * kSealedPieceBytes) + kTagBytes;
    SLX_ASSIGN_OR_RETURN(const size_t there, Fill(sealed.fd.get(), std::span(stored).first(size), file));
    unsigned long long opened = 0;
    if (there < size || crypto_aead_xchacha20poly1305_ietf_decrypt(
                            plain.data(), &opened, nullptr, stored.data(), size, BytesOf(data), data.size(),
                            NonceOf(sealed.header, piece).data(), key.bytes.data()) != 0)
      return Status::Integrity(file.string() + " cannot be opened with its session's key: it was changed, at byte " +
                               std::to_string(piece * kSealedPieceBytes) + " or later of what it holds");
    SLX_RETURN_IF_ERROR(use(std::span<const uint8_t>(plain).first(opened)));
  }
  return Status::Ok();
}

}  // namespace

Status FileSeal::CheckHeader(const fs::path& sealed, const std::set<std::string>& places) const {
  return OpenSealedFile(sealed, key_id_, places).status();
}

Status FileSeal::Check(const fs::path& file, const std::set<std::string>& places) {
  SLX_ASSIGN_OR_RETURN(const OpenSealed sealed, OpenSealedFile(file, key_id_, places));
  SLX_RETURN_IF_ERROR(RequireKey());
  return OpenPieces(sealed, file, session_id_, keys_->piece, [](std::span<const uint8_t>) { return Status::Ok(); });
}

Status FileSeal::Open(const fs::path& file, const std::set<std::string>& places, const fs::path& into) {
  SLX_ASSIGN_OR_RETURN(const OpenSealed sealed, OpenSealedFile(file, key_id_, places));
  SLX_RETURN_IF_ERROR(RequireKey());
  const UniqueFd to(open(into.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600));
  if (!to.ok()) return Cannot("create", into);
  const Status opened = OpenPieces(sealed, file, session_id_, keys_->piece, [&](std::span<const uint8_t> plain) {
    return WriteAll(to.get(), plain.data(), plain.size(), into.string());
  });
  // Of a file that is not whole nothing is shown.
  if (!opened.ok() && ftruncate(to.get(), 0) != 0) return Cannot("empty", into);
  return opened;
}

}  // namespace stratalux::db
