// SPDX-License-Identifier: Apache-2.0
// Sealed keys: given back to the reader, session and key they were made for, and to nobody else.
#include "db/keys/sealed_key.h"

#include <cstring>

#include <gmock/gmock.h>
#include <sodium.h>
#include <sys/stat.h>

#include "tests/db/keys/random_key.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr const char* kSession = "s000017-0badcafe";
constexpr const char* kOther = "s000018-0badcafe";
constexpr size_t kHeader = 48, kBox = 48 + 64, kDigest = 16;

void Digest(const std::string& bytes, unsigned char* digest) {
  crypto_generichash(digest, 32, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(), nullptr, 0);
}

class SealedKeyTest : public ScratchFolderTest {
 protected:
  SealedKeyTest()
      : reader_(*ReaderKey::Create(folder_ / "reader.key")), key_(RandomKey()), session_(folder_ / kSession) {
    fs::create_directory(session_);
    fs::create_directory(folder_ / kOther);
    EXPECT_EQ(WriteSealedKey(session_, kSession, key_, reader_.public_key()).message(), "");
    file_ = SealedKeyFile(session_, IdOf(reader_.public_key()));
    bytes_ = ReadText(file_);
  }
  // As a file of `session` under its key's id.
  [[nodiscard]] Status Open(const std::string& session = kSession) const {
    return OpenSealedKey(folder_ / session, session, key_.id, reader_).status();
  }
  // `bytes` with the digest that a file with them has.
  [[nodiscard]] static std::string WithDigest(std::string bytes) {
    unsigned char digest[32];
    bytes.resize(bytes.size() - kDigest);
    Digest(bytes, digest);
    return bytes + std::string(reinterpret_cast<const char*>(digest), kDigest);
  }

  ReaderKey reader_;
  SessionKey key_;
  fs::path session_, file_;
  std::string bytes_;
};

TEST_F(SealedKeyTest, GiveTheKeyBackToTheirReader) {
  const auto opened = OpenSealedKey(session_, kSession, key_.id, reader_);
  ASSERT_TRUE(opened.ok()) << opened.status().message();
  EXPECT_EQ(opened->id, key_.id);
  EXPECT_EQ(opened->key->bytes, key_.key->bytes);
  EXPECT_EQ(bytes_.find(std::string(key_.key->bytes.begin(), key_.key->bytes.end())), std::string::npos);
  const auto header = ReadSealedKeyHeader(file_);
  ASSERT_TRUE(header.ok());
  EXPECT_EQ(header->session, kSession);
  EXPECT_EQ(header->key, key_.id);
  EXPECT_EQ(header->reader, IdOf(reader_.public_key()));
  EXPECT_EQ(CheckSealedKey(file_, kSession, key_.id).message(), "");
}

// docs/file-formats.md, "Sealed keys", opened here by the library alone.
TEST_F(SealedKeyTest, AreWhatTheDocumentSays) {
  const ReaderPublicKey& reader = reader_.public_key();
  unsigned char digest[32];
  Digest(std::string(reader.bytes.begin(), reader.bytes.end()), digest);
  const std::string reader_id(reinterpret_cast<const char*>(digest), 16);
  const std::string said = std::string("SLXSKEY\0", 8) + std::string("\1\0\0\0", 4) + std::string("\x10\0\0\0", 4) +
                           std::string(key_.id.begin(), key_.id.end()) + reader_id + kSession;
  ASSERT_EQ(bytes_.size(), said.size() + kBox + kDigest);
  EXPECT_EQ(bytes_.substr(0, said.size()), said);
  unsigned char open[64];
  ASSERT_EQ(crypto_box_seal_open(open, reinterpret_cast<const unsigned char*>(bytes_.data()) + said.size(), kBox,
                                 reader.bytes.data(), reader_.secret().bytes.data()),
            0);
  Digest(said + std::string(reader.bytes.begin(), reader.bytes.end()), digest);
  EXPECT_EQ(std::memcmp(open, digest, 32), 0);
  EXPECT_EQ(std::memcmp(open + 32, key_.key->bytes.data(), 32), 0);
  EXPECT_EQ(bytes_, WithDigest(bytes_));
}

TEST_F(SealedKeyTest, OfAnotherSessionReaderOrKeyAreRefused) {
  // Another session's file in this one's place.
  fs::copy_file(file_, SealedKeyFile(folder_ / kOther, IdOf(reader_.public_key())));
  EXPECT_EQ(Open(kOther).code(), StatusCode::kIntegrity);
  EXPECT_THAT(Open(kOther).message(), HasSubstr(std::string("is the sealed key of session ") + kSession));
  // The same, with that session's name put into it by one who knows the format.
  std::string renamed = bytes_;
  renamed.replace(kHeader, std::strlen(kOther), kOther);
  WriteText(SealedKeyFile(folder_ / kOther, IdOf(reader_.public_key())), WithDigest(renamed));
  EXPECT_EQ(Open(kOther).code(), StatusCode::kIntegrity);
  EXPECT_THAT(Open(kOther).message(), HasSubstr("cannot be opened with the reader's key"));

  const ReaderKey stranger = *ReaderKey::Create(folder_ / "stranger.key");
  const fs::path strangers = SealedKeyFile(session_, IdOf(stranger.public_key()));
  EXPECT_EQ(OpenSealedKey(session_, kSession, key_.id, stranger).status().code(), StatusCode::kNotFound);
  WriteText(strangers, bytes_);
  EXPECT_EQ(OpenSealedKey(session_, kSession, key_.id, stranger).status().code(), StatusCode::kIntegrity);
  std::string addressed = bytes_;
  addressed.replace(32, 16, std::string(reinterpret_cast<const char*>(IdOf(stranger.public_key()).bytes.data()), 16));
  WriteText(strangers, WithDigest(addressed));
  EXPECT_EQ(OpenSealedKey(session_, kSession, key_.id, stranger).status().code(), StatusCode::kIntegrity);

  EXPECT_EQ(OpenSealedKey(session_, kSession, RandomKey().id, reader_).status().code(), StatusCode::kIntegrity);
}

TEST_F(SealedKeyTest, AreRefusedCutLongerOrWithAnyBitChanged) {
  for (size_t size = 0; size < bytes_.size(); ++size) {
    WriteText(file_, bytes_.substr(0, size));
    EXPECT_EQ(Open().code(), StatusCode::kIntegrity) << size << " bytes";
  }
  WriteText(file_, bytes_ + "x");
  EXPECT_EQ(Open().code(), StatusCode::kIntegrity);
  EXPECT_THAT(Open().message(), HasSubstr(file_.string()));
  for (size_t at = 0; at < bytes_.size(); ++at) {
    std::string changed = bytes_;
    changed[at] = static_cast<char>(changed[at] ^ (1 << (at % 8)));
    WriteText(file_, changed);
    const bool newer = at >= 8 && at < 12 && Open().code() == StatusCode::kNewerSchema;
    EXPECT_TRUE(newer || Open().code() == StatusCode::kIntegrity) << "byte " << at;
    EXPECT_FALSE(CheckSealedKey(file_, kSession, key_.id).ok()) << "told without a key: byte " << at;
    // By one who makes the digest fit. (The key id and the session are asked for, the rest is bound.)
    WriteText(file_, WithDigest(changed));
    EXPECT_EQ(Open().ok(), at >= bytes_.size() - kDigest) << "byte " << at;
  }
  WriteText(file_, bytes_);
  EXPECT_TRUE(Open().ok());
}

TEST_F(SealedKeyTest, OfALaterVersionSaySo) {
  std::string later = bytes_;
  later[8] = 2;
  WriteText(file_, WithDigest(later));
  EXPECT_EQ(Open().code(), StatusCode::kNewerSchema);
  EXPECT_THAT(Open().message(), HasSubstr("version 2 of sealed keys"));
}

TEST_F(SealedKeyTest, AreFilesOfTheirOwn) {
  fs::remove(file_);
  EXPECT_EQ(Open().code(), StatusCode::kNotFound);
  ASSERT_EQ(mkfifo(file_.c_str(), 0600), 0);
  EXPECT_EQ(Open().code(), StatusCode::kIntegrity) << "and waits for nobody";
  fs::remove(file_);
  WriteText(folder_ / "aside", bytes_);
  fs::create_symlink(folder_ / "aside", file_);
  EXPECT_EQ(Open().code(), StatusCode::kIntegrity);
}

TEST_F(SealedKeyTest, AreNotMadeForAKeyThatNobodyHas) {
  const Status none = WriteSealedKey(session_, kSession, key_, ReaderPublicKey{});
  EXPECT_EQ(none.code(), StatusCode::kUsage);
  EXPECT_THAT(ListSealedKeys(session_), ElementsAre(file_));
}

TEST_F(SealedKeyTest, AreWipedWithWhatAKilledProgramLeftBeside) {
  const ReaderKey other = *ReaderKey::Create(folder_ / "other.key");
  ASSERT_TRUE(WriteSealedKey(session_, kSession, key_, other.public_key()).ok());
  WriteText(file_.string() + ".new", bytes_.substr(0, 20));
  WriteText(session_ / "manifest.json", "{}");
  ASSERT_TRUE(WipeSealedKey(session_, IdOf(reader_.public_key())).ok());
  EXPECT_THAT(ListSealedKeys(session_), ElementsAre(SealedKeyFile(session_, IdOf(other.public_key()))));
  EXPECT_FALSE(fs::exists(file_.string() + ".new"));
  WriteText(file_.string() + ".new", bytes_.substr(0, 20));
  ASSERT_TRUE(WipeSealedKeys(session_).ok());
  EXPECT_THAT(ListSealedKeys(session_), IsEmpty());
  EXPECT_FALSE(fs::exists(file_.string() + ".new"));
  EXPECT_TRUE(fs::exists(session_ / "manifest.json"));
  EXPECT_TRUE(WipeSealedKeys(session_).ok()) << "again is no error";
}

// What a source offers under a key's name may have any size: none of it is read.
TEST_F(SealedKeyTest, ThatAreTooLargeAreRefusedUnread) {
  for (const uintmax_t size : {uintmax_t{65'537}, uintmax_t{100'000'000'000}}) {
    fs::resize_file(file_, size);
    for (const Status& status :
         {Open(), ReadSealedKeyHeader(file_).status(), CheckSealedKey(file_, kSession, key_.id)}) {
      EXPECT_EQ(status.code(), StatusCode::kIntegrity) << status.message();
      for (const std::string& part : {file_.string(), std::to_string(size), std::string("65536")})
        EXPECT_THAT(status.message(), HasSubstr(part));
    }
  }
}

}  // namespace
}  // namespace stratalux::db
