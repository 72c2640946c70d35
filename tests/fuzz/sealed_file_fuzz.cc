// SPDX-License-Identifier: Apache-2.0
// Sealed files of artifacts and fits. The first byte says what the others are: the file as it lies there; one whose
// pieces are sealed by who has the key, whatever its header says; or a change of a file that was sealed rightly.
#include <algorithm>
#include <array>
#include <cstring>
#include <fstream>
#include <iterator>
#include <memory>
#include <vector>

#include <sodium.h>

#include "db/segment/sealed_file.h"
#include "tests/fuzz/target.h"

namespace {

using namespace stratalux;
using namespace stratalux::db;
namespace fs = std::filesystem;
using Bytes = std::vector<uint8_t>;

constexpr const char* kSession = "s000017-0badcafe";
constexpr const char* kPlace = "artifacts/shape-00/position.exr";
constexpr size_t kHeaderBytes = 64, kPlaceBytesAt = 12, kNonceAt = 32, kPlainBytesAt = 48, kTagBytes = 16;

Bytes ReadBytes(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

// A store with one key, the same in every run: kept inputs are sealed under it.
class Vault {
 public:
  Vault() : seal_(folder_.path(), kSession, std::string(32, '7')), keyless_("/nowhere", kSession, seal_.key_id()) {
    auto secret = std::make_shared<SecretKey>();
    secret->bytes.fill(0x5a);
    crypto_kdf_derive_from_key(piece_key_.data(), piece_key_.size(), 1, "SLXfiles", secret->bytes.data());
    SessionKey key;
    key.id.fill(0x77);
    key.key = std::move(secret);
    if (!ImportKey(folder_.path(), key).ok()) fuzz::Fault("no key to seal with");
  }

  Bytes Seal(const Bytes& plain) {
    const fs::path sealed = folder_.path() / "sealed";
    fs::remove(sealed);
    if (!seal_.Seal(folder_.Put("plain", plain), kPlace, sealed).ok()) fuzz::Fault("a file cannot be sealed");
    return ReadBytes(sealed);
  }

  // Of `bytes` behind the header and its place: each piece but its last 16 bytes is plain, and gets its tag there.
  void SealPieces(Bytes& bytes) const {
    uint32_t place = 0;
    std::memcpy(&place, bytes.data() + kPlaceBytesAt, sizeof place);
    if (place > bytes.size() - kHeaderBytes) return;
    const size_t begin = kHeaderBytes + place;
    const std::string data = std::string(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(begin)) + kSession;
    std::array<uint8_t, crypto_aead_xchacha20poly1305_ietf_NPUBBYTES> nonce{};
    std::memcpy(nonce.data(), bytes.data() + kNonceAt, 16);
    for (uint64_t piece = 0, at = begin; at + kTagBytes <= bytes.size(); ++piece) {
      const size_t size = std::min<size_t>(bytes.size() - at, kSealedPieceBytes + kTagBytes);
      std::memcpy(nonce.data() + 16, &piece, sizeof piece);
      if (size < kTagBytes) return;
      crypto_aead_xchacha20poly1305_ietf_encrypt(bytes.data() + at, nullptr, bytes.data() + at, size - kTagBytes,
                                                 reinterpret_cast<const uint8_t*>(data.data()), data.size(), nullptr,
                                                 nonce.data(), piece_key_.data());
      at += size;
    }
  }

  // Whether it opens; what it holds is then in `plain`.
  bool Open(const Bytes& bytes, Bytes& plain) {
    const fs::path file = folder_.Put("stored", bytes), into = folder_.path() / "opened";
    const auto header = ReadSealedHeader(file);
    const bool is_sealed = fuzz::Judge(header) && header->has_value();
    const Status said = seal_.CheckHeader(file, {kPlace}), whole = seal_.Check(file, {kPlace});
    const Status without_key = keyless_.Open(file, {kPlace}, into), opened = seal_.Open(file, {kPlace}, into);
    for (const Status& status : {said, whole, opened, without_key}) fuzz::Judge(status);
    if (without_key.ok()) fuzz::Fault("opened without its key");
    if (whole.code() != opened.code()) fuzz::Fault("a check says other than the opening");
    if (opened.ok() && (!said.ok() || !is_sealed)) fuzz::Fault("opened against its header");
    plain = ReadBytes(into);
    if (!opened.ok() && !plain.empty()) fuzz::Fault("something of a file that is not whole");
    if (opened.ok() && (*header)->plain_bytes != plain.size()) fuzz::Fault("another length than the header's");
    fs::remove(into);
    return opened.ok();
  }

 private:
  fuzz::InputFolder folder_;
  FileSeal seal_, keyless_;
  std::array<uint8_t, 32> piece_key_{};
};

// As it lies there: nobody without the key makes a file that opens.
void ReadAsItLies(Vault& vault, const Bytes& bytes) {
  Bytes plain;
  if (vault.Open(bytes, plain) && vault.Seal(plain) != bytes) fuzz::Fault("a forged file opened");
}

// What a holder of the key made: opened to just that, or refused for what its header says.
void ReadSealedPieces(Vault& vault, Bytes bytes) {
  if (bytes.size() < kHeaderBytes) return;
  const Bytes before = bytes;
  vault.SealPieces(bytes);
  Bytes plain;
  if (!vault.Open(bytes, plain)) return;
  const size_t begin = kHeaderBytes + std::strlen(kPlace), shown = std::min<size_t>(plain.size(), kSealedPieceBytes);
  if (!std::equal(plain.begin(), plain.begin() + static_cast<std::ptrdiff_t>(shown),
                  before.begin() + static_cast<std::ptrdiff_t>(begin)))
    fuzz::Fault("other bytes than were sealed");
}

// A byte changed, cut off, added or written as a length, or two stretches exchanged.
void Change(Bytes& sealed, uint8_t how, size_t at, uint8_t value) {
  at %= sealed.size();
  const size_t piece = std::min<size_t>((sealed.size() - at) / 2, kSealedPieceBytes + kTagBytes);
  const auto first = sealed.begin() + static_cast<std::ptrdiff_t>(at);
  const auto length = static_cast<uint64_t>(at);
  switch (how % 5) {
    case 0:
      sealed[at] ^= value;
      break;
    case 1:
      sealed.resize(at);
      break;
    case 2:
      sealed.insert(first, value);
      break;
    case 3:
      std::swap_ranges(first, first + static_cast<std::ptrdiff_t>(piece), first + static_cast<std::ptrdiff_t>(piece));
      break;
    default:  // by one who knows where the length stands
      sealed.resize(kHeaderBytes + std::strlen(kPlace) + at + kTagBytes);
      std::memcpy(sealed.data() + kPlainBytesAt, &length, sizeof length);
  }
}

// `order`: how, where (3 bytes), a value, how many whole pieces (hardly one has any: they take long); then plain
// bytes.
void ReadChanged(Vault& vault, std::span<const uint8_t> order) {
  constexpr size_t kOrder = 6;
  if (order.size() < kOrder) return;
  const size_t pieces = order[5] == 0xa2 ? 2 : order[5] == 0xa1 ? 1 : 0;
  Bytes plain(order.begin() + kOrder, order.end());
  for (size_t i = 0; i < pieces; ++i)  // each of other bytes
    plain.insert(plain.begin(), kSealedPieceBytes, static_cast<uint8_t>(order[4] + i));
  const Bytes sealed = vault.Seal(plain);
  Bytes changed = sealed, opened;
  Change(changed, order[0], size_t{order[1]} | size_t{order[2]} << 8U | size_t{order[3]} << 16U, order[4]);
  if (vault.Open(changed, opened) != (changed == sealed)) fuzz::Fault("opened though changed, or not though whole");
  if (changed == sealed && opened != plain) fuzz::Fault("other bytes than were sealed");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0 || sodium_init() < 0) return 0;
  static Vault vault;
  const Bytes rest(data + 1, data + size);
  if (data[0] % 3 == 0) ReadAsItLies(vault, rest);
  if (data[0] % 3 == 1) ReadSealedPieces(vault, rest);
  if (data[0] % 3 == 2) ReadChanged(vault, rest);
  return 0;
}
