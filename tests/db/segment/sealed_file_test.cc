// SPDX-License-Identifier: Apache-2.0
// Sealed files: given back where key, session and place are right, and by nothing else; the same bytes whoever seals.
#include "db/segment/sealed_file.h"

#include <cstring>

#include <gmock/gmock.h>
#include <sodium.h>

#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr const char* kSession = "s000017-0badcafe";
constexpr const char* kPlace = "artifacts/shape-00/position.exr";
constexpr size_t kHeader = 64;

// Bytes that no two pieces share.
std::string PlainBytes(size_t size) {
  std::string bytes(size, '\0');
  for (size_t i = 0; i < size; ++i) bytes[i] = static_cast<char>((i * 2654435761U) >> 24U ^ i >> 12U);
  return bytes;
}

class SealedFileTest : public ScratchFolderTest {
 protected:
  SealedFileTest() : key_(ToHex(CreateKey(folder_)->id)), seal_(folder_, kSession, key_) {}

  std::string Seal(const std::string& plain, const std::string& place = kPlace) {
    const fs::path from = folder_ / "plain", to = folder_ / "sealed";
    stratalux::WriteText(from, plain);
    fs::remove(to);
    EXPECT_EQ(seal_.Seal(from, place, to).message(), "");
    return ReadText(to);
  }
  // Status and plain bytes of opening `sealed` as a file at kPlace.
  std::pair<Status, std::string> Open(const std::string& sealed, FileSeal seal) {
    const fs::path file = folder_ / "stored", into = folder_ / "opened";
    stratalux::WriteText(file, sealed);
    Status status = seal.Open(file, {kPlace}, into);
    std::string plain = fs::exists(into) ? ReadText(into) : "";
    fs::remove(into);
    return {status, plain};
  }
  std::pair<Status, std::string> Open(const std::string& sealed) { return Open(sealed, seal_); }
  void ExpectRefused(const std::string& sealed, const std::string& why) {
    const auto [status, plain] = Open(sealed);
    EXPECT_EQ(status.code(), StatusCode::kIntegrity) << why << ": " << status.message();
    EXPECT_THAT(status.message(), HasSubstr((folder_ / "stored").string())) << why;
    EXPECT_EQ(plain, "") << why << ": nothing of a file that is not whole";
  }

  std::string key_;
  FileSeal seal_;
};

TEST_F(SealedFileTest, GiveBackEveryByteAtAnyLength) {
  for (const size_t size : {size_t{0}, size_t{1}, size_t{kSealedPieceBytes} - 1, size_t{kSealedPieceBytes},
                            size_t{kSealedPieceBytes} + 1, size_t{3 * kSealedPieceBytes} + 7}) {
    const std::string plain = PlainBytes(size), sealed = Seal(plain);
    const size_t pieces = std::max<size_t>(1, (size + kSealedPieceBytes - 1) / kSealedPieceBytes);
    EXPECT_EQ(sealed.size(), kHeader + std::strlen(kPlace) + size + 16 * pieces) << size;
    const auto [status, opened] = Open(sealed);
    EXPECT_EQ(status.message(), "") << size;
    EXPECT_TRUE(opened == plain) << size;
    const auto header = ReadSealedHeader(folder_ / "stored");
    ASSERT_TRUE(header.ok() && *header);
    EXPECT_EQ((*header)->key_id, key_);
    EXPECT_EQ((*header)->place, kPlace);
    EXPECT_EQ((*header)->plain_bytes, size);
  }
}

// docs/file-formats.md, "Sealed files", computed here by the library alone.
TEST_F(SealedFileTest, AreWhatTheDocumentSays) {
  const std::string plain = "a face", sealed = Seal(plain), place = kPlace;
  const auto* bytes = reinterpret_cast<const unsigned char*>(sealed.data());
  KeyId id{};
  sodium_hex2bin(id.data(), id.size(), key_.data(), key_.size(), nullptr, nullptr, nullptr);
  const auto key = FindKey(folder_, id);
  ASSERT_TRUE(key.ok());
  unsigned char piece_key[32], nonce_key[32];
  crypto_kdf_derive_from_key(piece_key, 32, 1, "SLXfiles", key->key->bytes.data());
  crypto_kdf_derive_from_key(nonce_key, 32, 2, "SLXfiles", key->key->bytes.data());

  std::string header = std::string("SLXSEAL\0", 8) + std::string("\1\0\0\0", 4) + std::string("\x1f\0\0\0", 4) +
                       std::string(reinterpret_cast<const char*>(id.data()), id.size()) + std::string(16, '\0') +
                       std::string("\6\0\0\0\0\0\0\0", 8) + std::string(8, '\0');
  const std::string hashed = header + place + kSession + plain;
  unsigned char nonce[24] = {};  // of piece 0
  crypto_generichash(nonce, 16, reinterpret_cast<const unsigned char*>(hashed.data()), hashed.size(), nonce_key, 32);
  header.replace(32, 16, reinterpret_cast<const char*>(nonce), 16);
  EXPECT_EQ(sealed.substr(0, kHeader), header);
  EXPECT_EQ(sealed.substr(kHeader, place.size()), place);

  const std::string data = header + place + kSession;
  std::string opened(plain.size(), '\0');
  const size_t begin = kHeader + place.size();
  EXPECT_EQ(crypto_aead_xchacha20poly1305_ietf_decrypt(
                reinterpret_cast<unsigned char*>(opened.data()), nullptr, nullptr, bytes + begin, sealed.size() - begin,
                reinterpret_cast<const unsigned char*>(data.data()), data.size(), nonce, piece_key),
            0);
  EXPECT_EQ(opened, plain);
}

TEST_F(SealedFileTest, AreTheSameBytesWhoeverSealsThem) {
  const std::string plain = PlainBytes(2 * kSealedPieceBytes), once = Seal(plain);
  FileSeal other(folder_, kSession, key_);
  ASSERT_TRUE(other.Seal(folder_ / "plain", kPlace, folder_ / "again").ok());
  EXPECT_TRUE(ReadText(folder_ / "again") == once);
  // Another place, another byte, or a byte more: other bytes everywhere.
  std::string changed = plain;
  changed.back() ^= 1;
  for (const std::string& different :
       {Seal(plain, "artifacts/shape-01/position.exr"), Seal(changed), Seal(plain + "x")}) {
    size_t equal = 0;
    for (size_t i = kHeader + std::strlen(kPlace); i < once.size(); ++i) equal += once[i] == different[i] ? 1 : 0;
    EXPECT_LT(equal, once.size() / 100);
  }
}

TEST_F(SealedFileTest, HoldNothingPlain) {
  const std::string plain(4096, 'x');
  EXPECT_THAT(Seal(plain), ::testing::Not(HasSubstr("xxxx")));
}

TEST_F(SealedFileTest, AnyFlippedBitIsRefused) {
  const std::string sealed = Seal("the map of a face");
  ASSERT_TRUE(Open(sealed).first.ok());
  for (size_t at = 0; at < sealed.size(); ++at) {
    std::string changed = sealed;
    changed[at] = static_cast<char>(changed[at] ^ 1 << at % 8);
    const auto [status, plain] = Open(changed);
    const bool version = at >= 8 && at < 12;
    EXPECT_EQ(status.code(), version ? StatusCode::kNewerSchema : StatusCode::kIntegrity) << "byte " << at;
    EXPECT_EQ(plain, "") << "byte " << at;
  }
}

TEST_F(SealedFileTest, CutSwappedOrLengthenedTheyAreRefused) {
  const std::string plain = PlainBytes(2 * kSealedPieceBytes + 5), sealed = Seal(plain);
  const size_t begin = kHeader + std::strlen(kPlace), piece = kSealedPieceBytes + 16;
  for (const size_t size :
       {size_t{0}, size_t{7}, size_t{40}, kHeader + 3, begin, begin + piece, begin + 2 * piece, sealed.size() - 1})
    ExpectRefused(sealed.substr(0, size), "cut to " + std::to_string(size));
  ExpectRefused(sealed + "x", "lengthened");
  const std::string first = sealed.substr(begin, piece), second = sealed.substr(begin + piece, piece);
  ExpectRefused(sealed.substr(0, begin) + second + first + sealed.substr(begin + 2 * piece), "pieces swapped");
  ExpectRefused(sealed.substr(0, begin) + first + first + sealed.substr(begin + 2 * piece), "a piece twice");
  ExpectRefused(plain, "plain");
  ExpectRefused("", "empty");
  // Cut at a piece, by one who knows the format: the length is right, and not what was sealed.
  std::string shorter = sealed.substr(0, begin + piece);
  const uint64_t length = kSealedPieceBytes;
  std::memcpy(shorter.data() + 48, &length, sizeof length);
  ExpectRefused(shorter, "cut, its header forged");
  uint64_t endless = ~uint64_t{0};
  std::memcpy(shorter.data() + 48, &endless, sizeof endless);
  ExpectRefused(shorter, "an endless length");
}

TEST_F(SealedFileTest, OfAnotherPlaceSessionOrKeyTheyAreRefused) {
  const std::string plain = "the map of a face";
  ExpectRefused(Seal(plain, "artifacts/shape-00/normal.exr"), "another file of the artifact");
  // Renamed by one who knows the format.
  std::string forged = Seal(plain, "artifacts/shape-01/position.exr");
  forged.replace(kHeader, std::strlen(kPlace), kPlace);
  ExpectRefused(forged, "another place, forged");
  const std::string sealed = Seal(plain);
  EXPECT_EQ(Open(sealed, FileSeal(folder_, "s000018-0badcafe", key_)).first.code(), StatusCode::kIntegrity);
  const std::string other_key = ToHex(CreateKey(folder_)->id);
  EXPECT_EQ(Open(sealed, FileSeal(folder_, kSession, other_key)).first.code(), StatusCode::kIntegrity);
  std::string forged_key = sealed;
  KeyId id{};
  sodium_hex2bin(id.data(), id.size(), other_key.data(), other_key.size(), nullptr, nullptr, nullptr);
  std::memcpy(forged_key.data() + 16, id.data(), id.size());
  EXPECT_EQ(Open(forged_key, FileSeal(folder_, kSession, other_key)).first.code(), StatusCode::kIntegrity);
}

TEST_F(SealedFileTest, WithoutTheKeyTheyCanBeCheckedAndNotOpened) {
  const std::string sealed = Seal("the map of a face");
  KeyId id{};
  sodium_hex2bin(id.data(), id.size(), key_.data(), key_.size(), nullptr, nullptr, nullptr);
  ASSERT_TRUE(DestroyKey(folder_, id).ok());
  FileSeal without(folder_, kSession, key_);
  const auto [status, plain] = Open(sealed, without);
  EXPECT_EQ(status.code(), StatusCode::kNotFound);
  EXPECT_THAT(status.message(), HasSubstr("key import"));
  EXPECT_THAT(status.message(), HasSubstr(kSession));
  EXPECT_EQ(plain, "");
  EXPECT_EQ(without.Seal(folder_ / "plain", kPlace, folder_ / "new").code(), StatusCode::kNotFound);
  EXPECT_FALSE(fs::exists(folder_ / "new"));
  EXPECT_TRUE(without.CheckHeader(folder_ / "stored", {kPlace}).ok());
  EXPECT_EQ(without.CheckHeader(folder_ / "stored", {"fits/f"}).code(), StatusCode::kIntegrity);
  EXPECT_EQ(without.CheckHeader(folder_ / "plain", {kPlace}).code(), StatusCode::kIntegrity);
}

}  // namespace
}  // namespace stratalux::db
