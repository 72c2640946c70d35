// SPDX-License-Identifier: Apache-2.0
// Encrypted sessions: read where the key is, by nobody else, and not a bit of them can be changed unseen.
#include <cstddef>
#include <cstring>
#include <optional>
#include <set>

#include <gmock/gmock.h>
#include <sys/stat.h>
#include <xxhash.h>

#include "db/care/verify.h"
#include "db/keys/key_store.h"
#include "db/segment/frame_cipher.h"
#include "db/segment/truth_segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

const WriterOptions kEncrypted{.encryption = Encryption::kPerSession};
constexpr size_t kFirst = 64, kHeader = sizeof(FrameHeader), kPayload = 36 + kCipherTagBytes;

FrameHeader HeaderAt(const std::vector<uint8_t>& bytes, size_t at) {
  FrameHeader header;
  std::memcpy(&header, bytes.data() + at, sizeof header);
  return header;
}

// As somebody does who knows the format but not the key: all hashes fit again.
void PutFrame(std::vector<uint8_t>& bytes, size_t at, FrameHeader header) {
  XXH128_canonical_t hash;
  XXH128_canonicalFromHash(&hash, XXH3_128bits(bytes.data() + at + kHeader, header.payload_bytes));
  std::memcpy(header.payload_hash, hash.digest, sizeof header.payload_hash);
  header.header_hash = XXH3_64bits(&header, offsetof(FrameHeader, header_hash));
  std::memcpy(bytes.data() + at, &header, sizeof header);
}

bool Holds(const std::vector<uint8_t>& bytes, std::span<const uint8_t> part) {
  return std::search(bytes.begin(), bytes.end(), part.begin(), part.end()) != bytes.end();
}

class EncryptionTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    id_ = StoreSession(3, kEncrypted);
    rows_ = *OpenStore(AccessMode::kReadOnly).ListFrames(id_);
    bytes_ = ReadBytes(Segment(id_));
  }
  // The code of reading `frame` after the segment was replaced by `bytes`.
  [[nodiscard]] StatusCode CodeOf(const std::vector<uint8_t>& bytes, size_t frame = 0) {
    if (!reader_) reader_.emplace(OpenStore(AccessMode::kReadOnly));
    WriteBytes(Segment(id_), bytes);
    return reader_->ReadFrame(id_, rows_[frame]).status().code();
  }
  [[nodiscard]] KeyId Key(const std::string& id) const {
    const auto bytes = ReadBytes(Segment(id));
    return KeyIdOf(HeaderAt(bytes, kFirst));
  }

  std::string id_;
  std::vector<FrameRow> rows_;
  std::vector<uint8_t> bytes_;
  std::optional<SessionStore> reader_;
};

TEST_F(EncryptionTest, GivesBackEveryPixelAndStoresNone) {
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  const std::string plain = StoreSession(3);
  const auto plain_bytes = ReadBytes(Segment(plain));
  for (size_t i = 0; i < rows_.size(); ++i) {
    const auto image = store.ReadFrame(id_, rows_[i]);
    ASSERT_TRUE(image.ok()) << image.status().message();
    const auto expected = PixelsFor(rows_[i].record);
    EXPECT_TRUE(std::equal(image->pixels().begin(), image->pixels().end(), expected.pixels().begin()));
    const auto payload = std::span(plain_bytes).subspan(kFirst + i * (kHeader + 36) + kHeader, 36);
    EXPECT_TRUE(Holds(plain_bytes, payload));
    EXPECT_FALSE(Holds(bytes_, payload.first(8))) << "frame " << i;
  }
  EXPECT_EQ(store.FindSession(id_)->key_id, ToHex(Key(id_)));
  EXPECT_EQ(store.FindSession(plain)->key_id, "");
}

TEST_F(EncryptionTest, CoversTheTruthToo) {
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit(), kEncrypted);
  ASSERT_TRUE(writer.ok());
  Image<float> map(4, 4, 1, 0.123F);
  ASSERT_TRUE(AppendTo(*writer, 0).ok());
  ASSERT_TRUE(writer->AppendTruth("depth", std::as_const(map).view()).ok());
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  const auto file = store.SessionFolder(writer->info().id) / "truth.seg";
  EXPECT_FALSE(Holds(ReadBytes(file), std::span(reinterpret_cast<const uint8_t*>(map.data()), 8)));
  const auto truth = TruthSegment::Open(file);
  ASSERT_TRUE(truth.ok());
  EXPECT_EQ(truth->Read("depth")->pixels()[5], 0.123F);
  ASSERT_TRUE(DestroyKey(folder_, Key(writer->info().id)).ok());
  EXPECT_EQ(truth->Read("depth").status().code(), StatusCode::kNotFound);
}

TEST_F(EncryptionTest, AnyChangedByteIsRefusedEvenWithFittingHashes) {
  int refused = 0;
  ASSERT_EQ(CodeOf(bytes_), StatusCode::kOk);
  const auto intact = *reader_->ReadFrame(id_, rows_[0]);
  for (size_t at = kFirst; at < kFirst + kHeader + kPayload; ++at) {
    auto bytes = bytes_;
    bytes[at] ^= static_cast<uint8_t>(1U << (at % 8));
    const size_t in_header = at - kFirst;
    // Of a damaged header the footer holds a copy, which gives what was stored and nothing else.
    const StatusCode damaged = CodeOf(bytes);
    if (in_header < kHeader) {
      ASSERT_EQ(damaged, StatusCode::kOk) << "byte " << at;
      EXPECT_TRUE(std::ranges::equal(reader_->ReadFrame(id_, rows_[0])->pixels(), intact.pixels())) << "byte " << at;
    } else {
      EXPECT_EQ(damaged, StatusCode::kIntegrity) << "byte " << at;
      ++refused;
    }
    const bool sized =
        in_header >= offsetof(FrameHeader, payload_bytes) && in_header < offsetof(FrameHeader, payload_hash);
    const bool hashes =
        in_header >= offsetof(FrameHeader, payload_hash) && in_header < offsetof(FrameHeader, retake_cause);
    const bool own = in_header < 4 || (in_header >= offsetof(FrameHeader, header_hash) && in_header < kHeader);
    if (sized || hashes || own) continue;  // PutFrame sets these
    PutFrame(bytes, kFirst, HeaderAt(bytes, kFirst));
    const StatusCode code = CodeOf(bytes);
    const bool key = in_header >= offsetof(FrameHeader, key_id) && in_header < offsetof(FrameHeader, nonce);
    const bool cipher = in_header >= offsetof(FrameHeader, cipher) && in_header < offsetof(FrameHeader, width);
    // Another key id names no key; another cipher is unknown, and none at all leaves a payload of the wrong length.
    EXPECT_EQ(code, key ? StatusCode::kNotFound : cipher ? code : StatusCode::kIntegrity) << "byte " << at;
    EXPECT_NE(code, StatusCode::kOk) << "byte " << at;
    ++refused;
  }
  std::printf("%d changed frames refused\n", refused);
}

TEST_F(EncryptionTest, AFrameInAnothersPlaceIsRefused) {
  const size_t second = kFirst + kHeader + kPayload;
  // The second frame's header in front of the first one's payload, and the other way round.
  auto bytes = bytes_;
  PutFrame(bytes, kFirst, HeaderAt(bytes_, second));
  EXPECT_EQ(CodeOf(bytes), StatusCode::kIntegrity);
  bytes = bytes_;
  PutFrame(bytes, second, HeaderAt(bytes_, kFirst));
  EXPECT_EQ(CodeOf(bytes, 1), StatusCode::kIntegrity);
  // The first one's header that claims the second one's number.
  bytes = bytes_;
  FrameHeader header = HeaderAt(bytes_, kFirst);
  header.step = 1;
  PutFrame(bytes, kFirst, header);
  EXPECT_EQ(CodeOf(bytes), StatusCode::kIntegrity);
  EXPECT_EQ(CodeOf(bytes_), StatusCode::kOk);
}

TEST_F(EncryptionTest, APlainFrameInAnEncryptedSessionIsRefused) {
  const std::string plain = StoreSession(1);
  const auto source = ReadBytes(Segment(plain));
  auto bytes = bytes_;
  bytes.resize(kFirst);
  bytes.insert(bytes.end(), source.begin() + kFirst, source.end());
  EXPECT_EQ(CodeOf(bytes), StatusCode::kIntegrity);
}

TEST_F(EncryptionTest, AFrameOfAnotherSessionIsRefused) {
  auto bytes = bytes_;
  const std::string other = "s000009-00000000";
  std::copy(other.begin(), other.end(), bytes.begin() + 16);
  const uint64_t hash = XXH3_64bits(bytes.data(), 56);
  std::memcpy(bytes.data() + 56, &hash, sizeof hash);
  EXPECT_EQ(CodeOf(bytes), StatusCode::kIntegrity);
}

TEST_F(EncryptionTest, NoTwoFramesShareANonceAndNoTwoSessionsAKey) {
  std::set<std::string> keys, nonces;
  size_t frames = 0;
  for (int session = 0; session < 5; ++session) {
    SessionStore store = OpenStore();
    auto writer =
        store.BeginSession(SimulatedVisit(), {.max_segment_bytes = 2000, .encryption = Encryption::kPerSession});
    ASSERT_TRUE(writer.ok());
    const Image<float> map(2, 2);
    for (int i = 0; i < 20; ++i) ASSERT_TRUE(AppendTo(*writer, i).ok());
    for (int i = 0; i < 3; ++i) ASSERT_TRUE(writer->AppendTruth("m" + std::to_string(i), map.view()).ok());
    ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    for (const auto& file : std::filesystem::directory_iterator(store.SessionFolder(writer->info().id))) {
      if (file.path().extension() != ".seg") continue;
      const auto reader = SegmentReader::Open(file.path());
      bool sealed = false;
      const auto found = reader->Walk(true, &sealed);
      for (const SegmentFrame& f : *found) {
        keys.insert(ToHex(KeyIdOf(f.header)));
        nonces.insert(std::string(std::begin(f.header.nonce), std::end(f.header.nonce)));
        ++frames;
      }
    }
  }
  EXPECT_EQ(frames, 5U * 23U);
  EXPECT_EQ(nonces.size(), frames);
  EXPECT_EQ(keys.size(), 5U);
  EXPECT_EQ(ListKeys(folder_)->size(), 6U) << "five and the fixture's";
  std::printf("%zu frames, %zu nonces, %zu keys\n", frames, nonces.size(), keys.size());
}

TEST_F(EncryptionTest, WriterOfOneKeyStartedAgainUsesOtherNonces) {
  const auto key = FindKey(folder_, Key(id_));
  ASSERT_TRUE(key.ok());
  FrameSealer first(id_, *key), second(id_, *key);
  FrameHeader a{}, b{};
  const std::vector<uint8_t> plain(100, 7);
  const auto sealed_a = first.Seal(a, plain), sealed_b = second.Seal(b, plain);
  EXPECT_NE(std::memcmp(a.nonce, b.nonce, sizeof a.nonce), 0);
  EXPECT_NE(*sealed_a, *sealed_b);
}

TEST_F(EncryptionTest, WithoutItsKeyASessionIsUnreadableAndStillSound) {
  const std::string other = StoreSession(2, kEncrypted);
  ASSERT_TRUE(DestroyKey(folder_, Key(id_)).ok());
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  const Status status = store.ReadFrame(id_, rows_[0]).status();
  EXPECT_EQ(status.code(), StatusCode::kNotFound);
  EXPECT_THAT(status.message(), HasSubstr(ToHex(Key(id_))));
  EXPECT_THAT(status.message(), HasSubstr("stratalux-db key export"));
  EXPECT_THAT(VerifySession(store, *store.FindSession(id_))->problems, IsEmpty()) << "hashes need no key";
  EXPECT_TRUE(store.ReadFrame(other, store.ListFrames(other)->front()).ok());
}

TEST_F(EncryptionTest, ADestroyedKeyIsInNoFile) {
  const auto key = FindKey(folder_, Key(id_));
  const std::string other = StoreSession(1, kEncrypted);
  const std::vector<uint8_t> secret(key->key->bytes.begin(), key->key->bytes.end());
  EXPECT_TRUE(Holds(ReadBytes(KeyFile(folder_)), secret)) << "the scan below must be able to fail";
  ASSERT_TRUE(DestroyKey(folder_, key->id).ok());
  int files = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder_)) {
    if (!entry.is_regular_file()) continue;
    EXPECT_FALSE(Holds(ReadBytes(entry.path()), secret)) << entry.path();
    ++files;
  }
  EXPECT_GT(files, 4);
  EXPECT_FALSE(std::filesystem::exists(KeyFile(folder_).string() + "-journal"));
  EXPECT_TRUE(FindKey(folder_, Key(other)).ok());
  EXPECT_EQ(FindKey(folder_, key->id).status().code(), StatusCode::kNotFound);
  EXPECT_TRUE(DestroyKey(folder_, key->id).ok()) << "again is no error";
}

TEST_F(EncryptionTest, KeysAreForTheirOwnerAloneAndInNoManifest) {
  struct stat info {};
  ASSERT_EQ(stat(KeyFile(folder_).c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600U);
  const auto key = FindKey(folder_, Key(id_));
  EXPECT_FALSE(Holds(ReadBytes(folder_ / "sessions" / id_ / "manifest.json"), key->key->bytes));
  EXPECT_FALSE(Holds(ReadBytes(folder_ / "index.sqlite"), key->key->bytes));
}

TEST_F(EncryptionTest, AForeignKeyFileIsRefusedAndPlainSessionsStayReadable) {
  const std::string plain = StoreSession(1);
  WriteText(KeyFile(folder_), std::string(8192, 'x'));
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  EXPECT_EQ(store.ReadFrame(id_, rows_[0]).status().code(), StatusCode::kIntegrity);
  EXPECT_TRUE(store.ReadFrame(plain, store.ListFrames(plain)->front()).ok());
}

}  // namespace
}  // namespace stratalux::db
