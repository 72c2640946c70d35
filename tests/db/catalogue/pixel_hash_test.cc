// SPDX-License-Identifier: Apache-2.0
// Every frame that is written carries the hash of its pixels, and every reading holds them against it.
#include "db/segment/pixel_hash.h"

#include <gmock/gmock.h>

#include "db/catalogue/pixel_digest.h"
#include "db/catalogue/session_index.h"
#include "db/segment/truth_segment.h"
#include "tests/db/forged_segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;

class PixelHashesOfAStore : public StoreTest {
 protected:
  [[nodiscard]] static std::string HexOf(const PixelHash& hash) {
    FrameHeader header{};
    SetPixelHash(header, hash);
    return HashText(header.pixel_hash);
  }
  // The column of the index: 32 digits, "" where it is NULL.
  [[nodiscard]] std::vector<std::string> Column() const {
    auto index = SessionIndex::Open(folder_, AccessMode::kReadOnly);
    auto select = index->connection().Prepare("SELECT lower(hex(pixel_hash)) FROM frames ORDER BY session, frame");
    std::vector<std::string> hashes;
    while (*select->Step()) hashes.push_back(select->Text(0));
    return hashes;
  }
};

TEST_F(PixelHashesOfAStore, HeaderIndexAndRowsSayTheSame) {
  const std::string id = StoreSession(5, Groups(2));
  const auto frames = *OpenStore(AccessMode::kReadOnly).ListFrames(id);
  const auto column = Column();
  ASSERT_EQ(column.size(), 5U);
  for (size_t i = 0; i < frames.size(); ++i) {
    const auto pixels = PixelsFor(frames[i].record);
    EXPECT_EQ(frames[i].pixel_hash, HexOf(HashPixels(PixelFormat::kMono12, pixels.pixels(), nullptr)));
    EXPECT_EQ(column[i], frames[i].pixel_hash);
  }
}

TEST_F(PixelHashesOfAStore, PixelsOfAnotherFrameAreRefusedThoughEveryStoredHashFits) {
  const std::string id = StoreSession(3);
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  const auto frames = *store.ListFrames(id);
  ForgeHeaders(Segment(id), [](FrameHeader& h) { h.pixel_hash[5] ^= h.frame == 1 ? 4U : 0U; });
  EXPECT_TRUE(store.ReadFrame(id, frames[0]).ok());
  const auto forged = store.ReadFrame(id, frames[1]);
  EXPECT_EQ(forged.status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(forged.status().message(), HasSubstr("session " + id));
  EXPECT_THAT(forged.status().message(), HasSubstr("frames-0001.seg, offset " + std::to_string(frames[1].offset)));
  EXPECT_THAT(forged.status().message(), HasSubstr("pixel hash"));
}

TEST_F(PixelHashesOfAStore, AnEncryptedSessionsHashesTellNothingWithoutItsKey) {
  const std::string id = StoreSession(3, {.encryption = Encryption::kPerSession});
  const std::string plain = StoreSession(3);
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  const auto sealed = *store.ListFrames(id), open = *store.ListFrames(plain);
  const auto key = FindKey(folder_, (*ListKeys(folder_))[0]);
  for (size_t i = 0; i < sealed.size(); ++i) {
    const auto image = store.ReadFrame(id, sealed[i]);
    ASSERT_TRUE(image.ok()) << image.status().message();
    EXPECT_EQ(sealed[i].pixel_hash, HexOf(HashPixels(PixelFormat::kMono12, image->pixels(), key->key.get())));
    EXPECT_NE(sealed[i].pixel_hash, open[i].pixel_hash) << "the same pixels";
  }
}

TEST_F(PixelHashesOfAStore, ThePixelHashIsPartOfWhatTheCipherAuthenticates) {
  const std::string id = StoreSession(1, {.encryption = Encryption::kPerSession});
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  const auto frames = *store.ListFrames(id);
  ForgeHeaders(Segment(id), [](FrameHeader& h) { h.pixel_hash[0] ^= 1U; });
  const auto image = store.ReadFrame(id, frames[0]);
  EXPECT_EQ(image.status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(image.status().message(), HasSubstr("changed after capture"));
}

TEST_F(PixelHashesOfAStore, TruthMapsCarryThem) {
  for (const Encryption encryption : {Encryption::kNone, Encryption::kPerSession}) {
    SessionStore store = OpenStore();
    auto writer = store.BeginSession(SimulatedVisit(), {.encryption = encryption});
    ASSERT_TRUE(writer.ok()) << writer.status().message();
    const Image<float> map(8, 8, 1, 2.0F);
    ASSERT_TRUE(writer->AppendTruth("depth", map.view()).ok());
    ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    const auto file = store.SessionFolder(writer->info().id) / "truth.seg";
    ASSERT_TRUE(TruthSegment::Open(file)->Read("depth").ok());
    ForgeHeaders(file, [](FrameHeader& h) {
      EXPECT_TRUE(HasPixelHash(h));
      h.pixel_hash[3] ^= 1U;
    });
    EXPECT_EQ(TruthSegment::Open(file)->Read("depth").status().code(), StatusCode::kIntegrity);
  }
}

TEST_F(PixelHashesOfAStore, SegmentsOfBeforeReadAsTheyDid) {
  const std::string id = StoreSession(3);
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  const auto row = *store.FindSession(id);
  const auto digest = PixelDigest(store, row, *store.ListFrames(id));
  ASSERT_TRUE(digest.ok()) << digest.status().message();
  ForgeHeaders(Segment(id), [](FrameHeader& h) { SetPixelHash(h, {}); });
  const auto frames = *store.ListFrames(id);
  for (const FrameRow& frame : frames) {
    EXPECT_EQ(frame.pixel_hash, "");
    EXPECT_TRUE(store.ReadFrame(id, frame).ok());
  }
  EXPECT_EQ(*PixelDigest(store, row, frames), *digest) << "decoded where nothing is recorded";
}

TEST_F(PixelHashesOfAStore, TheDigestFollowsThePixelsAndTheirOrder) {
  const std::string id = StoreSession(3), same = StoreSession(3, {.codec = StoreCodec::kRaw12}),
                    longer = StoreSession(4);
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  auto digest = [&](const std::string& session) {
    return *PixelDigest(store, *store.FindSession(session), *store.ListFrames(session));
  };
  EXPECT_EQ(digest(id).size(), 32U);
  EXPECT_EQ(digest(id), digest(same));
  EXPECT_NE(digest(id), digest(longer));
  auto frames = *store.ListFrames(id);
  std::swap(frames[0], frames[1]);
  EXPECT_NE(*PixelDigest(store, *store.FindSession(id), frames), digest(id));
}

TEST_F(PixelHashesOfAStore, WithoutItsKeyAnEncryptedSessionOfBeforeHasADigestStill) {
  const std::string id = StoreSession(2, {.encryption = Encryption::kPerSession});
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  auto frames = *store.ListFrames(id);
  for (FrameRow& frame : frames) frame.pixel_hash.clear();
  std::filesystem::remove(KeyFile(folder_));
  EXPECT_TRUE(PixelDigest(store, *store.FindSession(id), frames).ok());
}

}  // namespace
}  // namespace stratalux::db
