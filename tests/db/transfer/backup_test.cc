// SPDX-License-Identifier: Apache-2.0
// Backup: one damaged session is named and the others are copied; copies are reread in turn; a run that is broken off
// leaves a whole backup and is continued.
#include <csignal>
#include <fstream>

#include <nlohmann/json.hpp>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/base/sqlite.h"
#include "db/care/reindex.h"
#include "db/catalogue/consent.h"
#include "db/ledger/ledger.h"
#include "db/privacy/access_log.h"
#include "shared/base/read_file.h"
#include "tests/db/transfer/transfer_fixture.h"
#include "tests/support/held_open.h"

namespace stratalux::db {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::IsSupersetOf;
using ::testing::Not;
using ::testing::SizeIs;

class BackupTest : public TransferTest {
 protected:
  Result<BackupReport> BackUp(ScrubShare scrub = ScrubShare::kInTurn) {
    return Backup(folder_, {backup_, {}, scrub}, logger_);
  }
  [[nodiscard]] nlohmann::json List() const {
    return nlohmann::json::parse(ReadFile(backup_ / "backup.json").value(), nullptr, false);
  }
};

TEST_F(BackupTest, MadeWhileASessionIsWrittenItRestoresEveryFinishedOne) {
  const std::string first = StoreSession(3), second = StoreSession(2);
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit());
  ASSERT_TRUE(AppendTo(*writer, 0).ok());
  const auto made = BackUp();
  ASSERT_TRUE(made.ok()) << made.status().message();
  EXPECT_EQ(made->sessions, 2);
  EXPECT_THAT(made->left_out, SizeIs(1));
  const auto restored = RestoreNew();
  ASSERT_TRUE(restored.ok()) << restored.status().message();
  EXPECT_EQ(Ids(other_), (std::vector{second, first}));
  EXPECT_EQ(RestoreNew().status().code(), StatusCode::kUsage);
}

TEST_F(BackupTest, ASecondOneCopiesOnlyWhatIsNewAndDropsWhatWasForgotten) {
  const std::string first = StoreSession(3);
  ASSERT_TRUE(BackUp().ok());
  const std::string second = StoreSession(2);
  auto again = BackUp();
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(again->files_kept, 2) << "manifest and segment of the first";
  EXPECT_EQ(again->files_copied, 2);
  Forget(folder_, first);
  again = BackUp();
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(again->files_removed, 2);
  EXPECT_THAT(again->problems, IsEmpty());
  EXPECT_FALSE(std::filesystem::exists(backup_ / "sessions" / first));
  ASSERT_TRUE(RestoreNew().ok());
  EXPECT_EQ(Ids(other_), std::vector{second});
}

// What cannot be listed may hold the faces of forgotten people.
TEST_F(BackupTest, AFolderOfItThatCannotBeListedFailsIt) {
  StoreSession(1);
  ASSERT_TRUE(BackUp().ok());
  WriteText(backup_ / "deletions", "no folder, which not even root can list");
  const auto made = BackUp();
  EXPECT_EQ(made.status().code(), StatusCode::kFailed);
  EXPECT_THAT(made.status().message(), HasSubstr("cannot list " + (backup_ / "deletions").string()));
  std::filesystem::remove(backup_ / "deletions");
  EXPECT_TRUE(BackUp().ok());
}

// The index is copied first: a forgetting that was entered meanwhile finds its rows, and whose they were, in there.
TEST_F(BackupTest, WhoIsForgottenWhileItIsMadeLeavesNoPseudonymInIt) {
  const std::string gone = "v-5f3a91c2", stays = "v-77e0b3d4";
  std::string first;
  for (const std::string& visitor : {gone, stays}) {
    ASSERT_TRUE(GiveConsent(folder_, visitor, {"2026-03", "de", true, false, false, {}}).ok());
    SessionStore store = OpenStore();
    SessionInfo info;
    info.visitor = visitor;
    auto writer = store.BeginSession(info);
    ASSERT_TRUE(writer.ok()) << writer.status().message();
    ASSERT_TRUE(AppendTo(*writer, 0).ok());
    ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    if (first.empty()) first = writer->info().id;
    ASSERT_TRUE(LogAccess(folder_, "export", writer->info().id, "here:/tmp/" + visitor).ok());
  }
  ASSERT_TRUE(
      AppendToLedger(folder_, {LedgerKind::kForgetting, WallNow(), {first}, "", R"({"reason": "forget"})"}).ok());
  const auto made = BackUp();
  ASSERT_TRUE(made.ok()) << made.status().message();
  EXPECT_EQ(made->sessions, 1);
  const auto bytes = ReadBytes(backup_ / "index.sqlite");
  const std::string index(bytes.begin(), bytes.end());
  EXPECT_EQ(index.find(gone), std::string::npos);
  EXPECT_NE(index.find("here:/tmp/" + stays), std::string::npos);
  ASSERT_TRUE(RestoreNew().ok());
  const auto consents = ListConsents(other_, "");
  ASSERT_TRUE(consents.ok()) << consents.status().message();
  ASSERT_THAT(*consents, SizeIs(1));
  EXPECT_EQ(consents->front().visitor, stays);
}

TEST_F(BackupTest, KeysAreNeverInIt) {
  StoreSession(1);
  { ASSERT_TRUE(SessionStore::Create(far_ / "k").ok()); }
  std::filesystem::copy_file(far_ / "k" / "index.sqlite", folder_ / "keys.sqlite",
                             std::filesystem::copy_options::overwrite_existing);
  EXPECT_EQ(Backup(folder_, {backup_, backup_ / "keys"}, logger_).status().code(), StatusCode::kUsage);
  // Nor beside any other data, of which a forgetting would not know: this store's own, and another backup's.
  ASSERT_TRUE(Backup(folder_, {far_ / "second", {}}, logger_).ok());
  for (const auto& place : {folder_ / "keys.copy", folder_ / "sessions" / "keys.copy", far_ / "second" / "keys.copy"}) {
    const auto refused = Backup(folder_, {backup_, place}, logger_);
    EXPECT_EQ(refused.status().code(), StatusCode::kUsage) << place;
    EXPECT_THAT(refused.status().message(), HasSubstr("lies within"));
    EXPECT_FALSE(std::filesystem::exists(place));
  }
  // However it is named, and before the backup's first file is there.
  const std::filesystem::path here = std::filesystem::current_path();
  for (const auto& place : {folder_ / "sessions", far_ / "new"}) {
    std::filesystem::create_directories(place);
    std::filesystem::current_path(place);
    EXPECT_EQ(Backup(folder_, {place == far_ / "new" ? "." : backup_, "keys.copy"}, logger_).status().code(),
              StatusCode::kUsage);
    EXPECT_FALSE(std::filesystem::exists("keys.copy"));
    std::filesystem::current_path(here);
  }
  ASSERT_TRUE(Backup(folder_, {backup_, far_ / "keys.copy"}, logger_).ok());
  EXPECT_TRUE(std::filesystem::exists(far_ / "keys.copy"));
  for (const auto& entry : std::filesystem::recursive_directory_iterator(backup_))
    EXPECT_THAT(entry.path().string(), Not(HasSubstr("keys")));
}

// The issue's case: 7 sessions, one damaged, no backup before.
TEST_F(BackupTest, OneDamagedSessionOfSevenStopsNobodyNotEvenTheFirstTime) {
  std::vector<std::string> ids;
  for (int i = 0; i < 7; ++i) ids.push_back(StoreSession(1));
  FlipBits(Segment(ids[0]), 64 + 320 + 3, 1);
  const Outcome outcome = Db("backup --json --store " + folder_.string() + " --to " + backup_.string());
  EXPECT_EQ(outcome.code, 3) << outcome.out;
  EXPECT_THAT(outcome.out, HasSubstr("session " + ids[0]));
  EXPECT_THAT(List()["problems"], SizeIs(1));
  EXPECT_THAT(List()["problems"][0].get<std::string>(), HasSubstr("has no copy"));
  const auto restored = RestoreNew();
  ASSERT_TRUE(restored.ok()) << restored.status().message();
  EXPECT_EQ(restored->sessions, 6);
  EXPECT_THAT(Ids(other_), SizeIs(6));
}

TEST_F(BackupTest, WhatIsDamagedOrGoneInTheStoreKeepsItsLastGoodCopy) {
  const std::string damaged = StoreSession(2), cut = StoreSession(2), broken = StoreSession(1), lost = StoreSession(1);
  ASSERT_TRUE(BackUp().ok());
  const auto good = ReadBytes(Copied(damaged));
  FlipBits(Segment(damaged), 64 + 320 + 3, 1);
  std::filesystem::remove(Segment(cut));
  std::filesystem::remove_all(folder_ / "sessions" / lost);
  const auto index = Reindex(folder_, logger_);
  ASSERT_TRUE(index.ok()) << index.status().message();
  // Behind the reindex, which writes a manifest anew by the old index.
  WriteText(folder_ / "sessions" / broken / "manifest.json", "{");
  const std::string fresh = StoreSession(1);
  for (int i = 0; i < 3; ++i) {
    const auto made = BackUp(ScrubShare::kAll);
    ASSERT_TRUE(made.ok()) << made.status().message();
    EXPECT_THAT(made->problems, IsSupersetOf({HasSubstr(damaged), HasSubstr(cut), HasSubstr(broken), HasSubstr(lost)}));
  }
  EXPECT_EQ(ReadBytes(Copied(damaged)), good);
  const auto restored = RestoreNew();
  ASSERT_TRUE(restored.ok()) << restored.status().message();
  EXPECT_THAT(restored->problems, IsEmpty());
  EXPECT_THAT(Ids(other_), ::testing::UnorderedElementsAre(damaged, cut, broken, lost, fresh));
}

// Its segments and manifest change between one file's copy and the next.
TEST_F(BackupTest, ASessionThatIsTranscodedWhileItIsCopiedComesWhole) {
  std::string id;
  {
    SessionStore store = OpenStore();
    auto writer = store.BeginSession(SimulatedVisit(), {.codec = StoreCodec::kRaw12});
    ASSERT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < 3; ++i) {
      const Image<uint16_t> pixels(50, 40, 1, static_cast<uint16_t>(100 * i));
      ASSERT_TRUE(writer->Append(RecordFor(i, PixelFormat::kMono12, 50, 40), pixels.view()).ok());
    }
    ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    id = writer->info().id;
  }
  // Copied behind the segment and before the manifest, and read by nothing else.
  const std::filesystem::path between = folder_ / "sessions" / id / "frames-note.txt";
  WriteText(between, "a note");
  HeldOpen held(between, HeldOpen::Against::kReading);
  if (!held.taken()) GTEST_SKIP() << "no leases here";
  Result<BackupReport> made = BackupReport();
  std::thread backup([&] { made = BackUp(); });
  const bool copying = held.Wait();
  const Outcome transcoded = Db("transcode " + id + " --codec delta --store " + folder_.string());
  held.Release();
  backup.join();
  ASSERT_TRUE(copying);
  ASSERT_EQ(transcoded.code, 0) << transcoded.out;
  ASSERT_FALSE(std::filesystem::exists(Segment(id)));
  ASSERT_TRUE(made.ok()) << made.status().message();
  EXPECT_THAT(made->problems, IsEmpty());
  EXPECT_EQ(made->sessions, 1);
  EXPECT_TRUE(std::filesystem::exists(Copied(id, "frames-0002.seg")));
  const auto restored = RestoreNew();
  ASSERT_TRUE(restored.ok()) << restored.status().message();
  EXPECT_THAT(restored->problems, IsEmpty());
  EXPECT_EQ(Ids(other_), std::vector{id}) << "verified: its rows are those of its new segment";
}

TEST_F(BackupTest, ASymbolicLinkBringsNothingOfElsewhereIntoIt) {
  const std::string id = StoreSession(1);
  WriteText(far_ / "secret", "secret");
  std::filesystem::create_symlink(far_ / "secret", folder_ / "sessions" / id / "notes");
  const auto made = BackUp();
  ASSERT_TRUE(made.ok()) << made.status().message();
  EXPECT_THAT(made->problems, ElementsAre(HasSubstr("symbolic link")));
}

TEST_F(BackupTest, EightRunsRereadEveryCopyTheOldestFirst) {
  for (int i = 0; i < 6; ++i) StoreSession(1);
  ASSERT_TRUE(BackUp().ok());
  std::map<std::string, int64_t> first;
  const auto begun = List();
  for (const auto& file : begun["files"]) first[file["path"]] = file["checked_wall_ns"];
  EXPECT_EQ(begun["scrub_runs"], 8);
  for (int run = 0; run < 8; ++run) {
    const auto made = BackUp();
    ASSERT_TRUE(made.ok()) << made.status().message();
    EXPECT_EQ(made->files_reread, 2) << "an eighth of twelve, rounded up";
  }
  const auto ended = List();
  for (const auto& file : ended["files"])
    EXPECT_GT(file["checked_wall_ns"].get<int64_t>(), first[file["path"]]) << file["path"];
}

TEST_F(BackupTest, ARottenCopyIsMadeAgainOrNamedUntilItIsGood) {
  const std::string mendable = StoreSession(2), gone = StoreSession(2);
  ASSERT_TRUE(BackUp().ok());
  const auto good = ReadBytes(Copied(mendable));
  FlipBits(Copied(mendable), 400, 1);
  FlipBits(Copied(gone), 400, 1);
  const auto time = std::filesystem::last_write_time(Segment(gone));
  FlipBits(Segment(gone), 64 + 320 + 3, 1);
  std::filesystem::last_write_time(Segment(gone), time);  // rotted, too: nobody wrote it
  const Outcome outcome = Db("backup --scrub all --store " + folder_.string() + " --to " + backup_.string());
  EXPECT_EQ(outcome.code, 3);
  EXPECT_THAT(outcome.out, HasSubstr("damaged copy replaced: sessions/" + mendable));
  EXPECT_THAT(outcome.out, HasSubstr("is damaged in the backup, and the store has no good one"));
  EXPECT_EQ(ReadBytes(Copied(mendable)), good);
  const auto again = BackUp();  // in turn: what is known to be bad comes first
  ASSERT_TRUE(again.ok());
  EXPECT_THAT(again->problems, ElementsAre(HasSubstr(gone)));
  FlipBits(Segment(gone), 64 + 320 + 3, 1);
  std::filesystem::last_write_time(Segment(gone), time);
  const auto healed = BackUp();
  ASSERT_TRUE(healed.ok());
  EXPECT_THAT(healed->mended, ElementsAre(HasSubstr(gone)));
  EXPECT_THAT(healed->problems, IsEmpty());
}

TEST_F(BackupTest, ACutCopyIsMadeAgainAtOnce) {
  const std::string id = StoreSession(2);
  ASSERT_TRUE(BackUp().ok());
  std::filesystem::resize_file(Copied(id), 100);
  const auto made = BackUp();
  ASSERT_TRUE(made.ok());
  EXPECT_THAT(made->mended, SizeIs(1));
  EXPECT_EQ(ReadBytes(Copied(id)), ReadBytes(Segment(id)));
}

// A limit of a file's size is the full disk that every machine has.
TEST_F(BackupTest, AFullDiskIsSaidAndTheEarlierBackupStaysValid) {
  const std::string first = StoreSession(1);
  ASSERT_TRUE(BackUp().ok());
  const auto list = ReadBytes(backup_ / "backup.json");
  StoreSession(400, Groups(400));
  const Outcome outcome =
      Shell("ulimit -f 100; trap '' XFSZ; " + std::string(STRATALUX_BIN_DIR) + "/stratalux-db backup --store " +
            folder_.string() + " --to " + backup_.string() + " 2>&1");
  EXPECT_EQ(outcome.code, 1) << outcome.out;
  EXPECT_THAT(outcome.out, HasSubstr("stays valid, and the next run continues"));
  EXPECT_EQ(ReadBytes(backup_ / "backup.json"), list);
  ASSERT_TRUE(RestoreNew().ok());
  EXPECT_EQ(Ids(other_), std::vector{first});
  const auto made = BackUp();
  ASSERT_TRUE(made.ok()) << made.status().message();
  EXPECT_EQ(made->sessions, 2);
}

TEST_F(BackupTest, KilledAnywhereItIsWholeAndGoesOn) {
  std::vector<std::string> ids;
  ids.push_back(StoreSession(2));
  ASSERT_TRUE(BackUp().ok());
  for (int i = 0; i < 12; ++i) {
    ids.insert(ids.begin(), StoreSession(3));
    WriteText(folder_ / "sessions" / ids.back() / "fits-note.txt", std::to_string(i));  // a listed file that changes
    RunAndKill({"backup", "--store", folder_.string(), "--to", backup_.string()}, std::chrono::milliseconds(2 + 5 * i));
    std::filesystem::remove_all(other_);
    const auto restored = RestoreNew();
    ASSERT_TRUE(restored.ok()) << restored.status().message();
    EXPECT_THAT(restored->problems, IsEmpty()) << i;
    EXPECT_GE(restored->sessions, 1);
  }
  const auto made = BackUp(ScrubShare::kAll);
  ASSERT_TRUE(made.ok()) << made.status().message();
  EXPECT_THAT(made->problems, IsEmpty());
  std::filesystem::remove_all(other_);
  ASSERT_TRUE(RestoreNew().ok());
  EXPECT_EQ(Ids(other_), ids);
  EXPECT_FALSE(std::filesystem::exists(backup_ / "backup.unfinished"));
}

// The journal in which a run was deleting rows of its own snapshot when it was killed.
TEST_F(BackupTest, AKilledRunsJournalIsNotRolledIntoTheNextIndex) {
  StoreSession(40, Groups(40));
  ASSERT_TRUE(BackUp().ok());
  {
    auto earlier = Connection::Open(backup_ / "index.sqlite", Connection::Mode::kReadWrite);
    ASSERT_TRUE(earlier.ok()) << earlier.status().message();
    // The journal's head tells its records only where it is synced, or where it says that it never is.
    ASSERT_TRUE(earlier->Execute("PRAGMA synchronous = OFF; BEGIN IMMEDIATE; DELETE FROM frames").ok());
    std::filesystem::create_directories(backup_ / "index.new");
    std::filesystem::copy_file(backup_ / "index.sqlite-journal", backup_ / "index.new" / "index.sqlite-journal");
    ASSERT_TRUE(earlier->Execute("ROLLBACK").ok());
  }
  ASSERT_GT(std::filesystem::file_size(backup_ / "index.new" / "index.sqlite-journal"), 4096U);
  for (int i = 0; i < 3; ++i) StoreSession(40, Groups(40));
  const auto made = BackUp();
  ASSERT_TRUE(made.ok()) << made.status().message();
  EXPECT_THAT(made->problems, IsEmpty());
  auto index = Connection::Open(backup_ / "index.sqlite", Connection::Mode::kReadOnly);
  ASSERT_TRUE(index.ok()) << index.status().message();
  EXPECT_EQ(*index->QueryInteger("SELECT count(*) FROM pragma_integrity_check WHERE integrity_check <> 'ok'"), 0);
  EXPECT_EQ(*index->QueryInteger("SELECT count(*) FROM sessions"), 4);
  EXPECT_EQ(*index->QueryInteger("SELECT count(*) FROM frames"), 160);
}

TEST_F(BackupTest, WhatAnInterruptedRunCopiedIsNotCopiedAgain) {
  const std::string id = StoreSession(2);
  ASSERT_TRUE(BackUp().ok());
  nlohmann::json entry;
  const auto list = List();
  for (const auto& listed : list["files"])
    if (listed["path"] == "sessions/" + id + "/frames-0001.seg") entry = listed;
  std::filesystem::remove(backup_ / "backup.json");  // as if broken off before the list
  const std::string journal = "a backup is being made, or was interrupted\n";
  WriteText(backup_ / "backup.unfinished", journal + entry.dump() + "\n{\"path\": \"torn");
  const auto made = BackUp();
  ASSERT_TRUE(made.ok()) << made.status().message();
  EXPECT_EQ(made->files_continued, 1);
  EXPECT_EQ(made->files_copied, 1) << "the manifest, which the journal does not name";
}

TEST_F(BackupTest, TheLedgerIsInItAndNeverGetsShorter) {
  const std::string id = StoreSession(1);
  ASSERT_TRUE(AppendToLedger(folder_, {LedgerKind::kWithdrawal, WallNow(), {id}, std::string(64, 'a'), ""}).ok());
  ASSERT_TRUE(BackUp().ok());
  std::filesystem::remove_all(folder_ / "ledger");
  ASSERT_TRUE(BackUp().ok());
  const auto ledger = Ledger::Read(backup_);
  ASSERT_TRUE(ledger.ok()) << ledger.status().message();
  EXPECT_TRUE(ledger->WithdrawnAt(id).has_value());
}

TEST_F(BackupTest, ABackupOfALaterVersionIsLeftAlone) {
  StoreSession(1);
  ASSERT_TRUE(BackUp().ok());
  auto list = List();
  list["schema"] = 99;
  WriteText(backup_ / "backup.json", list.dump());
  EXPECT_EQ(BackUp().status().code(), StatusCode::kNewerSchema);
  EXPECT_EQ(List(), list);
}

TEST_F(BackupTest, ACopyOfTheKeysThatFailsLeavesNothingOfThem) {
  StoreSession(1, {.encryption = Encryption::kPerSession});
  {
    auto keys = Connection::Open(folder_ / "keys.sqlite", Connection::Mode::kReadWrite);
    ASSERT_TRUE(keys.ok()) << keys.status().message();
    const Status filled = keys->Execute(
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 16000)"
        " INSERT INTO keys SELECT randomblob(16), randomblob(32), i FROM n");
    ASSERT_TRUE(filled.ok()) << filled.message();
  }
  const auto copy = far_ / "keys.copy", part = far_ / "keys.copy.part";
  constexpr rlim_t kMost = 256 << 10;
  ASSERT_GT(std::filesystem::file_size(folder_ / "keys.sqlite"), 2 * kMost);
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    std::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{kMost, kMost};
    setrlimit(RLIMIT_FSIZE, &limit);
    _exit(Backup(folder_, {backup_, copy, ScrubShare::kInTurn}, logger_).ok() ? 1 : 0);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  EXPECT_FALSE(std::filesystem::exists(copy));
  EXPECT_FALSE(std::filesystem::exists(part));
  const auto made = Backup(folder_, {backup_, copy, ScrubShare::kInTurn}, logger_);
  ASSERT_TRUE(made.ok()) << made.status().message();
  EXPECT_TRUE(std::filesystem::exists(copy));
}

TEST_F(BackupTest, WhatAKilledCopyOfTheKeysLeftIsOverwritten) {
  StoreSession(1, {.encryption = Encryption::kPerSession});
  const auto copy = far_ / "keys.copy", part = far_ / "keys.copy.part";
  WriteText(part, "keys");
  std::filesystem::permissions(part, static_cast<std::filesystem::perms>(0644));
  const auto refused = Backup(folder_, {backup_, copy, ScrubShare::kInTurn}, logger_);
  EXPECT_EQ(refused.status().code(), StatusCode::kUsage) << "none of ours has this mode";
  EXPECT_THAT(refused.status().message(), HasSubstr(part.string()));
  EXPECT_EQ(ReadFile(part).value(), "keys");
  std::filesystem::permissions(part, static_cast<std::filesystem::perms>(0600));
  std::ifstream held(part);
  const auto made = Backup(folder_, {backup_, copy, ScrubShare::kInTurn}, logger_);
  ASSERT_TRUE(made.ok()) << made.status().message();
  std::string left(4, '?');
  held.read(left.data(), 4);
  EXPECT_EQ(left, std::string(4, '\0'));
  EXPECT_TRUE(std::filesystem::exists(copy));
  EXPECT_FALSE(std::filesystem::exists(part));
}

}  // namespace
}  // namespace stratalux::db
