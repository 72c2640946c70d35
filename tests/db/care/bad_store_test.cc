// SPDX-License-Identifier: Apache-2.0
// A store whose index, folders or disk are not what they were: said, nothing lost, the other sessions readable.
#include <chrono>
#include <cstdio>
#include <fstream>
#include <map>

#include <gmock/gmock.h>
#include <sys/mount.h>
#include <unistd.h>

#include "db/base/sqlite.h"
#include "db/care/verify.h"
#include "db/catalogue/manifest.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class BadStoreTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    first_ = StoreSession(3);
    second_ = StoreSession(2);
  }
  [[nodiscard]] fs::path Index() const { return folder_ / "index.sqlite"; }
  [[nodiscard]] fs::path Session(const std::string& id) const { return folder_ / "sessions" / id; }
  static std::vector<std::string> Problems(const SessionStore& store, const std::string& id) {
    return VerifySession(store, *store.FindSession(id))->problems;
  }
  static void ExpectReadable(const SessionStore& store, const std::string& id, size_t frames) {
    const auto rows = store.ListFrames(id);
    ASSERT_TRUE(rows.ok()) << rows.status().message();
    EXPECT_EQ(rows->size(), frames);
    for (const FrameRow& f : *rows) {
      const auto image = store.ReadFrame(id, f);
      ASSERT_TRUE(image.ok()) << image.status().message();
      EXPECT_TRUE(std::ranges::equal(image->pixels(), PixelsFor(f.record).pixels()));
    }
  }

  std::string first_, second_;
};

// SQLite's pages carry no checksum: what the index says of a frame is held against the frame's own header.
TEST_F(BadStoreTest, AFlippedBitInTheIndexGivesNoWrongPixels) {
  const auto intact = ReadBytes(Index());
  std::map<StatusCode, int> outcomes;
  int flips = 0;
  const auto note = [&outcomes](const Status& status) { ++outcomes[status.code()]; };
  for (size_t i = 0; i < intact.size(); i += 1 + (i * 7) % 487, ++flips) {
    SCOPED_TRACE("byte " + std::to_string(i));
    FlipBits(Index(), i, static_cast<uint8_t>(1U << (i % 8)));
    const auto store = SessionStore::Open(folder_, AccessMode::kReadOnly);
    note(store.status());
    for (const std::string& id : {first_, second_}) {
      if (!store.ok()) break;
      const auto rows = store->ListFrames(id);
      note(rows.status());
      for (size_t k = 0; rows.ok() && k < rows->size(); ++k) {
        const auto image = store->ReadFrame(id, (*rows)[k]);
        ASSERT_TRUE(!image.ok() || std::ranges::equal(image->pixels(), PixelsFor((*rows)[k].record).pixels()));
      }
      if (const auto row = store->FindSession(id); row.ok()) note(VerifySession(*store, *row).status());
    }
    FlipBits(Index(), i, static_cast<uint8_t>(1U << (i % 8)));
  }
  std::printf("%d bits of the index flipped:", flips);
  for (const auto& [code, count] : outcomes) std::printf(" %d x code %d", count, static_cast<int>(code));
  std::printf("; no wrong pixel\n");
  EXPECT_GT(flips, 200);
  EXPECT_GT(outcomes[StatusCode::kIntegrity], 0);
  EXPECT_EQ(outcomes[StatusCode::kUsage], 0) << "damage is nobody's wrong flag";
  ExpectReadable(OpenStore(), first_, 3);
}

TEST_F(BadStoreTest, AFlippedBitInAManifestHidesNoFrame) {
  const fs::path manifest = Session(first_) / "manifest.json";
  const size_t size = ReadBytes(manifest).size();
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  size_t found = 0;
  for (size_t i = 0; i < size; ++i) {
    const auto mask = static_cast<uint8_t>(1U << (i % 8));
    FlipBits(manifest, i, mask);
    found += Problems(store, first_).empty() ? 0 : 1;
    ExpectReadable(store, first_, 3);
    FlipBits(manifest, i, mask);
  }
  std::printf("%zu bits of a manifest flipped, %zu found by verify; every frame readable\n", size, found);
  EXPECT_EQ(found, size) << "the manifest carries its own hash";
}

TEST_F(BadStoreTest, AMissingIndexIsNotReplacedByAnEmptyOne) {
  const auto intact = ReadBytes(Index());
  fs::remove(Index());
  for (const Status& status :
       {SessionStore::Create(folder_), SessionStore::Open(folder_, AccessMode::kReadOnly).status(),
        SessionStore::Open(folder_, AccessMode::kReadWrite).status()}) {
    EXPECT_EQ(status.code(), StatusCode::kIntegrity);
    EXPECT_THAT(status.message(), HasSubstr("index.sqlite is missing, but sessions are there"));
    EXPECT_THAT(status.message(), HasSubstr("reindex"));
  }
  EXPECT_FALSE(fs::exists(Index()));
  WriteBytes(Index(), {});
  EXPECT_EQ(SessionStore::Create(folder_).code(), StatusCode::kIntegrity) << "nor is one that lost its bytes";
  EXPECT_TRUE(ReadBytes(Index()).empty());
  WriteBytes(Index(), intact);
  ExpectReadable(OpenStore(), first_, 3);
}

TEST_F(BadStoreTest, AnIndexDeletedWhileItsLogRemainsIsNotReplaced) {
  // Read by a connection that lives on, the log stays.
  const SessionStore reader = OpenStore(AccessMode::kReadOnly);
  ASSERT_TRUE(reader.ListSessions().ok());
  const std::string third = StoreSession(1);
  const auto log = ReadBytes(Index().string() + "-wal"), index = ReadBytes(Index());
  ASSERT_GT(log.size(), 0U);
  const fs::path other = folder_ / "other";
  fs::create_directories(other / "sessions");
  WriteBytes(other / "index.sqlite-wal", log);
  EXPECT_EQ(SessionStore::Create(other).code(), StatusCode::kIntegrity);
  EXPECT_EQ(SessionStore::Open(other, AccessMode::kReadWrite).status().code(), StatusCode::kIntegrity);
  EXPECT_EQ(ReadBytes(other / "index.sqlite-wal"), log) << "what it holds may be all that is left";
  // With its index again, nothing is lost.
  WriteBytes(other / "index.sqlite", index);
  EXPECT_TRUE(SessionStore::Open(other, AccessMode::kReadOnly)->FindSession(third).ok());
}

TEST_F(BadStoreTest, AClockThatRunsBackwardsChangesNoOrder) {
  SessionStore store = OpenStore();
  std::vector<std::string> ids = {second_, first_};
  for (const int64_t wall : {int64_t{2'000'000'000'000'000'000}, int64_t{1'000'000'000}, int64_t{0}, int64_t{7}}) {
    SessionInfo info;
    info.simulated = true;
    info.started_wall = {wall};
    auto writer = store.BeginSession(info);
    ASSERT_TRUE(writer.ok()) << writer.status().message();
    ASSERT_TRUE(AppendTo(*writer, 0).ok());
    ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    ids.insert(ids.begin(), writer->info().id);
  }
  const auto rows = store.ListSessions();
  ASSERT_EQ(rows->size(), ids.size());
  for (size_t i = 0; i < ids.size(); ++i) EXPECT_EQ((*rows)[i].info.id, ids[i]);
  EXPECT_EQ(store.FindSession("latest")->info.id, ids[0]);
  EXPECT_TRUE(std::is_sorted(ids.rbegin(), ids.rend())) << "ids tell the order, too";
}

TEST_F(BadStoreTest, AManifestMustNameWhatIsThere) {
  const SessionStore store = OpenStore();
  const SessionInfo info = store.FindSession(first_)->info;
  const fs::path folder = Session(first_);
  ASSERT_TRUE(WriteManifest(folder, info, 3, {"frames-0001.seg", "frames-0007.seg"}).ok());
  EXPECT_THAT(Problems(store, first_), Contains(HasSubstr("names frames-0007.seg, which is not there")));
  ASSERT_TRUE(WriteManifest(folder, info, 3, {"../" + second_ + "/frames-0001.seg"}).ok());
  EXPECT_THAT(Problems(store, first_), Contains(HasSubstr("which is not there"))) << "files of others are not its own";
  ASSERT_TRUE(WriteManifest(folder, info, 9, {"frames-0001.seg"}).ok());
  EXPECT_THAT(Problems(store, first_), Contains(HasSubstr("lists 9 frames, the index lists 3")));
  SessionInfo other = info;
  other.status = SessionStatus::kDegraded;
  ASSERT_TRUE(WriteManifest(folder, other, 3, {"frames-0001.seg"}).ok());
  EXPECT_THAT(Problems(store, first_), Contains(HasSubstr("says 'degraded', the index 'complete'")));
  ASSERT_TRUE(WriteManifest(folder, info, 3, {"frames-0001.seg"}).ok());
  EXPECT_THAT(Problems(store, first_), IsEmpty());
}

TEST_F(BadStoreTest, EmptyPicturesAndFilesAreNamed) {
  SessionStore store = OpenStore();
  {
    SessionInfo info;
    info.simulated = true;
    auto writer = store.BeginSession(info);
    EXPECT_EQ(writer->Append(RecordFor(0, PixelFormat::kMono12, 0, 0), ImageView<const uint16_t>()).code(),
              StatusCode::kUsage);
    ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    EXPECT_THAT(Problems(store, writer->info().id), IsEmpty());
  }
  WriteBytes(Segment(first_), {});
  const auto rows = store.ListFrames(first_);
  EXPECT_EQ(rows.status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(rows.status().message(), HasSubstr(Segment(first_).string() + ": truncated: 0 bytes"));
  EXPECT_THAT(Problems(store, first_), Contains(HasSubstr("truncated: 0 bytes")));
  ExpectReadable(store, second_, 2);
}

TEST_F(BadStoreTest, AMissingSessionFolderIsNamedAndTheOthersStay) {
  fs::remove_all(Session(first_));
  const SessionStore store = OpenStore();
  const auto rows = store.ListFrames(first_);
  EXPECT_EQ(rows.status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(rows.status().message(), HasSubstr("restore sessions/" + first_));
  EXPECT_THAT(Problems(store, first_), Contains(HasSubstr(Session(first_).string() + ": No such file")));
  ExpectReadable(store, second_, 2);
}

TEST_F(BadStoreTest, SessionsMovedBehindASymbolicLinkAreReadAsBefore) {
  const fs::path elsewhere = folder_ / "big-disk";
  fs::rename(Session(first_), elsewhere);
  fs::create_directory_symlink(elsewhere, Session(first_));
  const SessionStore store = OpenStore();
  ExpectReadable(store, first_, 3);
  EXPECT_THAT(Problems(store, first_), IsEmpty());
  // A link that leads nowhere, or to itself, is a missing folder.
  fs::remove(Session(first_));
  fs::create_directory_symlink(Session(first_), Session(first_));
  EXPECT_EQ(store.ListFrames(first_).status().code(), StatusCode::kFailed);
  EXPECT_THAT(Problems(store, first_), Contains(HasSubstr("symbolic links")));
  ExpectReadable(store, second_, 2);
}

// The store, seen through a mount that cannot be written, as root sees no file modes.
class ReadOnlyDisk : public BadStoreTest {
 protected:
  void SetUp() override {
    BadStoreTest::SetUp();
    frozen_ = folder_.string() + "-frozen";
    fs::create_directory(frozen_);
  }
  void TearDown() override {
    if (mounted_) umount2(frozen_.c_str(), MNT_DETACH);
    fs::remove(frozen_);
    BadStoreTest::TearDown();
  }
  [[nodiscard]] bool Freeze() {
    if (mount(folder_.c_str(), frozen_.c_str(), nullptr, MS_BIND, nullptr) != 0) return false;
    mounted_ = true;
    return mount(nullptr, frozen_.c_str(), nullptr, MS_BIND | MS_REMOUNT | MS_RDONLY, nullptr) == 0;
  }
  void ExpectRead(size_t sessions) const {
    for (const AccessMode mode : {AccessMode::kReadOnly, AccessMode::kReadWrite}) {
      auto store = SessionStore::Open(frozen_, mode);
      ASSERT_TRUE(store.ok()) << store.status().message();
      ASSERT_TRUE(store->ListSessions().ok());
      EXPECT_EQ(store->ListSessions()->size(), sessions);
      ExpectReadable(*store, first_, 3);
      EXPECT_THAT(Problems(*store, first_), IsEmpty());
      SessionInfo info;
      info.simulated = true;
      const auto writer = store->BeginSession(info);
      EXPECT_EQ(writer.status().code(), StatusCode::kFailed);
      EXPECT_THAT(writer.status().message(), AllOf(HasSubstr(frozen_.string()), HasSubstr("Read-only file system")));
      const Status fit = store->RegisterFit({"f1", first_, "{}", "{}", {5}});
      EXPECT_EQ(fit.code(), StatusCode::kFailed);
      EXPECT_THAT(fit.message(), HasSubstr("ead-only"));
    }
  }

  fs::path frozen_;
  bool mounted_ = false;
};

TEST_F(ReadOnlyDisk, IsReadAndNotWritten) {
  if (!Freeze()) GTEST_SKIP() << "no read-only mount can be made here";
  ExpectRead(2);
}

TEST_F(ReadOnlyDisk, IsReadWithTheLogThatACrashLeft) {
  std::string third;
  {
    // The log survives its writers: SQLite's files as a power cut leaves them.
    SessionStore store = OpenStore();
    SessionInfo info;
    info.simulated = true;
    auto writer = store.BeginSession(info, Groups(2));
    third = writer->info().id;
    for (int i = 0; i < 5; ++i) ASSERT_TRUE(AppendTo(*writer, i).ok());
    fs::create_directory(folder_ / "kept");
    for (const char* file : {"index.sqlite", "index.sqlite-wal"}) fs::copy(folder_ / file, folder_ / "kept" / file);
  }
  for (const char* file : {"index.sqlite", "index.sqlite-wal"}) fs::rename(folder_ / "kept" / file, folder_ / file);
  fs::remove(folder_ / "index.sqlite-shm");
  if (!Freeze()) GTEST_SKIP() << "no read-only mount can be made here";
  ExpectRead(3);
  const auto before = ReadBytes(Segment(third));
  for (const AccessMode mode : {AccessMode::kReadOnly, AccessMode::kReadWrite}) {
    const auto store = SessionStore::Open(frozen_, mode);
    EXPECT_THAT(store->notes(), Contains(AllOf(HasSubstr(third), HasSubstr("356 bytes to be cut"))));
    ExpectReadable(*store, third, 4);
  }
  EXPECT_EQ(ReadBytes(Segment(third)), before);
}

}  // namespace
}  // namespace stratalux::db
