// SPDX-License-Identifier: Apache-2.0
// A signature tells a session from a forgery in which every hash fits.
#include "db/catalogue/signature.h"

#include <gmock/gmock.h>
#include <sys/stat.h>

#include "db/care/session_rebuild.h"
#include "db/care/transcode.h"
#include "db/care/verify.h"
#include "db/catalogue/manifest.h"
#include "tests/db/forged_segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class SignatureTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    auto key = RigKey::Create(folder_);
    ASSERT_TRUE(key.ok()) << key.status().message();
    key_ = key->public_key();
  }
  [[nodiscard]] std::string StoreSigned(Encryption encryption = Encryption::kNone) const {
    return StoreSession(3, {.encryption = encryption, .signing = Signing::kRigKey});
  }
  [[nodiscard]] std::vector<std::string> Problems(const std::string& id, VerifyDepth depth,
                                                  std::optional<PublicKey> key) const {
    const SessionStore store = OpenStore(AccessMode::kReadOnly);
    VerifyOptions options{depth};
    options.signed_by = key;
    const auto report = VerifySession(store, *store.FindSession(id), options);
    EXPECT_TRUE(report.ok());
    if (report->problems.empty()) {
      EXPECT_EQ(fs::exists(store.SessionFolder(id) / "signature.json"), report->signed_by.has_value());
    }
    return report->problems;
  }
  // As a forger would, who knows the formats and not the key.
  void MakeAllAnew(const std::string& id) const {
    ASSERT_TRUE(ReplaceSegments(folder_ / "sessions" / id, {"frames-0001.seg"}).ok());
    auto index = SessionIndex::Open(folder_, AccessMode::kReadWrite);
    const auto session = RebuildSession(folder_ / "sessions" / id);
    ASSERT_TRUE(session.ok());
    const int64_t number = *index->NumberOf(id);
    ASSERT_TRUE(index->connection().Execute("DELETE FROM sessions WHERE id = '" + id + "'").ok());
    ASSERT_TRUE(InsertRebuilt(*index, *session, number).ok());
  }
  PublicKey key_{};
};

TEST_F(SignatureTest, IsValidForWhatWasCaptured) {
  for (const Encryption encryption : {Encryption::kNone, Encryption::kPerSession}) {
    const std::string id = StoreSigned(encryption);
    EXPECT_THAT(Problems(id, VerifyDepth::kHeaders, key_), IsEmpty());
    EXPECT_THAT(Problems(id, VerifyDepth::kDeep, key_), IsEmpty());
    EXPECT_THAT(Problems(id, VerifyDepth::kDeep, {}), IsEmpty());
  }
}

TEST_F(SignatureTest, NeedsNoKeyOfAnEncryptedSession) {
  const std::string id = StoreSigned(Encryption::kPerSession);
  fs::remove(folder_ / "keys.sqlite");
  EXPECT_THAT(Problems(id, VerifyDepth::kDeep, key_), IsEmpty());
}

TEST_F(SignatureTest, ATranscodeLeavesItValid) {
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit(), {.codec = StoreCodec::kDelta, .signing = Signing::kRigKey});
  for (int i = 0; i < 3; ++i) {
    const FrameRecord record = RecordFor(i, PixelFormat::kMono12, 50, 40);
    const Image<uint16_t> flat(50, 40, 1, static_cast<uint16_t>(100 + i));
    ASSERT_TRUE(writer->Append(record, flat.view()).ok());
  }
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  const std::string id = writer->info().id;
  const auto before = ReadBytes(store.SessionFolder(id) / "signature.json");
  writer = Status::Ok();  // lets the store's lock go
  Logger logger(LogLevel::kError);
  Progress progress(logger, "transcode", 6);
  const auto report = TranscodeSession(store, *store.FindSession(id), {.codec = StoreCodec::kRaw12}, progress);
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_EQ(report->changed, 3);
  EXPECT_THAT(Problems(id, VerifyDepth::kDeep, key_), IsEmpty());
  EXPECT_EQ(ReadBytes(store.SessionFolder(id) / "signature.json"), before);
}

TEST_F(SignatureTest, AForgedHeaderIsFoundThoughEveryHashFits) {
  const std::string id = StoreSigned();
  ForgeHeaders(Segment(id), [](FrameHeader& header) { header.exposure_ms = 99; });
  MakeAllAnew(id);
  EXPECT_THAT(Problems(id, VerifyDepth::kHeaders, {}),
              Contains(HasSubstr("signature.json: the signature does not match")));
}

TEST_F(SignatureTest, AForgedManifestIsFoundThoughEveryHashFits) {
  const std::string id = StoreSigned();
  auto info = *ReadManifest(folder_ / "sessions" / id);
  info.rig = "another";
  ASSERT_TRUE(WriteManifest(folder_ / "sessions" / id, info, 3, {"frames-0001.seg"}).ok());
  MakeAllAnew(id);
  EXPECT_THAT(Problems(id, VerifyDepth::kHeaders, {}),
              Contains(HasSubstr("signature.json: the signature does not match")));
}

TEST_F(SignatureTest, AnotherKeyOrNoneIsSaid) {
  const std::string one = StoreSigned(), plain = StoreSession(1);
  PublicKey other = key_;
  other[0] ^= 1U;
  EXPECT_THAT(Problems(one, VerifyDepth::kHeaders, other), Contains(HasSubstr("is signed with another key")));
  EXPECT_THAT(Problems(plain, VerifyDepth::kHeaders, key_), Contains(HasSubstr(plain + " is not signed")));
  EXPECT_THAT(Problems(plain, VerifyDepth::kHeaders, {}), IsEmpty());
}

TEST_F(SignatureTest, AnyChangeOfTheSignatureIsFound) {
  const std::string id = StoreSigned();
  const fs::path file = folder_ / "sessions" / id / "signature.json";
  const auto intact = ReadBytes(file);
  for (size_t i = 0; i < intact.size(); ++i) {
    if (std::isspace(intact[i]) != 0) continue;  // a blank more or less says nothing
    FlipBits(file, i, static_cast<uint8_t>(1U << (i % 7)));
    // Hexadecimal digits of either case are the same number.
    if (std::tolower(ReadBytes(file)[i]) != std::tolower(intact[i])) {
      EXPECT_FALSE(Problems(id, VerifyDepth::kDeep, key_).empty()) << "byte " << i;
    }
    FlipBits(file, i, static_cast<uint8_t>(1U << (i % 7)));
  }
  fs::remove(file);
  EXPECT_THAT(Problems(id, VerifyDepth::kHeaders, key_), Contains(HasSubstr("is not signed")));
}

TEST_F(SignatureTest, ASessionWhoseWriterDiedIsSignedByTheNextOpening) {
  std::string id;
  {
    SessionStore store = OpenStore();
    auto writer = store.BeginSession(SimulatedVisit(), {.group_frames = 1, .signing = Signing::kRigKey});
    for (int i = 0; i < 3; ++i) ASSERT_TRUE(AppendTo(*writer, i).ok());
    id = writer->info().id;
  }
  EXPECT_EQ(OpenStore().FindSession(id)->info.status, SessionStatus::kFailed);
  EXPECT_THAT(Problems(id, VerifyDepth::kDeep, key_), IsEmpty());
}

TEST_F(SignatureTest, TheKeyIsPrivateAndThereOnce) {
  struct stat info {};
  ASSERT_EQ(stat(RigKeyFile(folder_).c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600U);
  EXPECT_EQ(RigKey::Create(folder_).status().code(), StatusCode::kUsage) << "a second one would orphan the signatures";
  EXPECT_EQ(RigKey::Read(folder_)->public_key(), key_);
  chmod(RigKeyFile(folder_).c_str(), 0640);
  EXPECT_THAT(RigKey::Read(folder_).status().message(), HasSubstr("can be read by others"));
  chmod(RigKeyFile(folder_).c_str(), 0600);
  WriteText(RigKeyFile(folder_), "stratalux rig key 1 ed25519\nabc\n");
  EXPECT_EQ(RigKey::Read(folder_).status().code(), StatusCode::kIntegrity);
  fs::remove(RigKeyFile(folder_));
  SessionStore store = OpenStore();
  const auto writer = store.BeginSession(SimulatedVisit(), {.signing = Signing::kRigKey});
  EXPECT_EQ(writer.status().code(), StatusCode::kNotFound) << "before the rig moves, not after";
  EXPECT_THAT(writer.status().message(), HasSubstr("key sign-init"));
}

}  // namespace
}  // namespace stratalux::db
