// SPDX-License-Identifier: Apache-2.0
// What was forgotten is in no byte of the store, does not come back, and can be interrupted anywhere.
#include "db/privacy/forget.h"

#include <csignal>
#include <fstream>
#include <random>
#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/wait.h>
#include <unistd.h>

#include "db/base/sqlite.h"
#include "db/base/write_lock.h"
#include "db/care/verify.h"
#include "db/catalogue/deletions.h"
#include "db/interchange/import.h"
#include "db/keys/key_store.h"
#include "db/privacy/access_log.h"
#include "db/privacy/key_file.h"
#include "shared/base/read_file.h"
#include "tests/db/privacy/forget_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

TEST_F(ForgetTest, LeavesNoTraceInAnyByteOfTheStore) {
  for (const Encryption encryption : {Encryption::kPerSession, Encryption::kNone}) {
    SCOPED_TRACE(encryption == Encryption::kNone ? "plain" : "encrypted");
    ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"2026-03", "de", true, true, false, {}}).ok());
    const std::string id = Visit(kVisitor, 1, encryption), other = Visit(kOther, 2, encryption);
    const Traces traces = TracesOf(id);
    // The oracle must be able to find them.
    const RawFiles before = ReadRaw(folder_);
    EXPECT_GE(FilesWith(before, traces.id).size(), 5U);
    EXPECT_GE(FilesWith(before, kVisitor).size(), 3U);
    for (const std::string& hash : traces.hashes) EXPECT_GE(FilesWith(before, hash).size(), 2U);
    if (encryption == Encryption::kPerSession) {
      EXPECT_EQ(FilesWith(before, traces.key).size(), 1U);
    }

    const auto report = ForgetNow({id});
    ASSERT_TRUE(report.ok()) << report.status().message();
    EXPECT_THAT(report->leftovers, IsEmpty());
    EXPECT_TRUE(report->sessions[0].visitor_removed);
    ExpectGone(traces, kVisitor);
    EXPECT_FALSE(fs::exists(exports_ / id)) << "the export goes, too";
    EXPECT_TRUE(fs::exists(exports_ / other));
    ExpectUnharmed(other, 2);
    EXPECT_THAT(*ListConsents(folder_, kVisitor), IsEmpty());
    EXPECT_EQ(ListConsents(folder_, kOther)->size(), 1U);
    std::printf("%s: %zu markers looked for by the program in %lld files, found none; %zu by the test in raw bytes\n",
                encryption == Encryption::kNone ? "plain" : "encrypted", static_cast<size_t>(report->markers),
                static_cast<long long>(report->scanned_files), traces.hashes.size() + 3);
  }
}

TEST_F(ForgetTest, ClearsPagesThatWereFreedLongBefore) {
  // Many rows, so that deleting frees whole pages, and a log that was never cut.
  std::vector<std::string> ids;
  for (int i = 0; i < 12; ++i) ids.push_back(Visit(i % 2 == 0 ? kVisitor : kOther, i + 1, Encryption::kNone));
  std::vector<Traces> traces;
  std::vector<std::string> mine;
  for (size_t i = 0; i < ids.size(); i += 2) {
    mine.push_back(ids[i]);
    traces.push_back(TracesOf(ids[i]));
  }
  const auto report = ForgetNow(mine);
  ASSERT_TRUE(report.ok()) << report.status().message();
  for (const Traces& t : traces) ExpectGone(t, kVisitor);
  for (size_t i = 1; i < ids.size(); i += 2) ExpectUnharmed(ids[i], static_cast<int>(i) + 1);
}

TEST_F(ForgetTest, KeepsTheVisitorWhileASessionIsLeft) {
  const std::string first = Visit(kVisitor, 1, Encryption::kNone), second = Visit(kVisitor, 2, Encryption::kNone);
  const auto once = ForgetNow({first});
  ASSERT_TRUE(once.ok()) << once.status().message();
  EXPECT_FALSE(once->sessions[0].visitor_removed);
  EXPECT_THAT(once->leftovers, IsEmpty());
  EXPECT_EQ(ListConsents(folder_, kVisitor)->size(), 1U);
  ExpectUnharmed(second, 2);
  EXPECT_TRUE(ForgetNow({second})->sessions[0].visitor_removed);
}

TEST_F(ForgetTest, SharedPixelsOfARemainingSessionAreNoLeftover) {
  const std::string id = Visit(kVisitor, 3, Encryption::kNone), twin = Visit(kOther, 3, Encryption::kNone);
  const auto report = ForgetNow({id});
  ASSERT_TRUE(report.ok());
  EXPECT_THAT(report->leftovers, IsEmpty());
  ExpectUnharmed(twin, 3);
}

TEST_F(ForgetTest, FinishesWhateverThePointAtWhichItStopped) {
  const std::string other = Visit(kOther, 99, Encryption::kPerSession);
  int points = 0;
  for (bool finished = false; !finished; ++points) {
    ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"2026-03", "de", true, true, false, {}}).ok());
    const std::string id = Visit(kVisitor, 1 + points, Encryption::kPerSession);
    const Traces traces = TracesOf(id);
    const WallNs given = ListConsents(folder_, kVisitor)->back().consent.given_wall;
    int left = points;
    const int ended = ForgetApart(id, [&left](ForgetStep) {
      if (left-- == 0) _exit(9);
    });
    ASSERT_TRUE(ended == 9 || ended == 0) << ended;
    finished = ended == 0;
    SCOPED_TRACE("point " + std::to_string(points));
    EXPECT_EQ(*IsForgotten(folder_, id), points > 0) << "from the entry on, which follows the note of what must go";
    { const SessionStore reopened = OpenStore(); }  // recovery must not bring it back
    const auto again = ForgetNow({});
    ASSERT_TRUE(again.ok()) << again.status().message();
    EXPECT_THAT(again->leftovers, IsEmpty());
    ExpectGone(traces, kVisitor);
    EXPECT_THAT(*UnfinishedForgets(folder_), IsEmpty());
    const Ledger ledger = *Ledger::Read(folder_);
    EXPECT_EQ(std::ranges::count_if(ledger.entries(),
                                    [given](const LedgerEntry& entry) {
                                      const auto forgotten = ConsentsForgottenBy(entry);
                                      return std::ranges::find(forgotten, given) != forgotten.end();
                                    }),
              1)
        << "that the visitor is forgotten, once";
    ASSERT_FALSE(::testing::Test::HasFailure());
  }
  ExpectUnharmed(other, 99);
  EXPECT_GE(points, 12);
  std::printf("stopped at %d points, finished from each\n", points - 1);
}

TEST_F(ForgetTest, FinishesAfterBeingKilledAtAnyMoment) {
  std::mt19937 random(11);
  const std::string other = Visit(kOther, 99, Encryption::kPerSession);
  int killed = 0;
  for (int round = 0; round < 40; ++round) {
    ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"2026-03", "de", true, true, false, {}}).ok());
    const std::string id = Visit(kVisitor, 1 + round, Encryption::kPerSession);
    const Traces traces = TracesOf(id);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) _exit(ForgetNow({id}).ok() ? 0 : 1);
    std::this_thread::sleep_for(std::chrono::microseconds(random() % 12000));
    kill(child, SIGKILL);
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    killed += WIFSIGNALED(status) ? 1 : 0;
    const bool listed = OpenStore(AccessMode::kReadOnly).FindSession(id).ok();
    const auto again = ForgetNow(listed ? std::vector{id} : std::vector<std::string>{});
    ASSERT_TRUE(again.ok()) << again.status().message();
    EXPECT_THAT(again->leftovers, IsEmpty());
    ExpectGone(traces, kVisitor);
    ASSERT_FALSE(::testing::Test::HasFailure()) << "round " << round;
  }
  ExpectUnharmed(other, 99);
  std::printf("killed %d times of 40, finished after each\n", killed);
}

TEST_F(ForgetTest, FinishesAfterAWriteOrAWipeThatWasTorn) {
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession), other = Visit(kOther, 2, Encryption::kNone);
  const Traces traces = TracesOf(id);
  ASSERT_TRUE(ForgetNow({id}).ok());
  const fs::path ledger = folder_ / "ledger";
  WriteText(ledger / (id + ".forgetting.wiping"), std::string(40, '\0') + kVisitor + traces.hashes[0]);
  WriteText(ledger / (other + ".forgetting.new"), "{ \"session\": \"" + other);
  EXPECT_FALSE(*IsForgotten(folder_, other)) << "not begun";
  const auto again = ForgetNow({});
  ASSERT_TRUE(again.ok()) << again.status().message();
  ExpectGone(traces, kVisitor);
  ExpectUnharmed(other, 2);
}

TEST_F(ForgetTest, CertifiesWithoutPixelsAndWithoutThePseudonym) {
  exports_ /= kVisitor;  // an operator who files exports by visitor
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession);
  const Traces traces = TracesOf(id);
  ASSERT_TRUE(ForgetNow({id}).ok());
  const auto json = CertificateOf(id);
  EXPECT_EQ(json["session"], id);
  EXPECT_EQ(json["reason"], "forget");
  EXPECT_EQ(json["frames"], 6);
  EXPECT_EQ(json["fits"], 1);
  EXPECT_EQ(json["key_destroyed"], true);
  EXPECT_EQ(json["visitor_removed"], true);
  EXPECT_EQ(json["verification"]["clean"], true);
  EXPECT_GT(json["verification"]["markers"], 6);
  EXPECT_THAT(json["exports"][0]["place"].get<std::string>(), HasSubstr("(forgotten)"));
  EXPECT_EQ(json["exports"][0]["state"], "deleted");
  ExpectGone(traces, kVisitor);
  const auto deletions = ListDeletions(folder_);
  ASSERT_EQ(deletions->size(), 1U);
  EXPECT_EQ(nlohmann::json::parse((*deletions)[0].certificate_json), json);
  ASSERT_FALSE(ListAccess(folder_, id)->empty()) << "who looked outlives the session";
  fs::remove_all(exports_.parent_path());
}

TEST_F(ForgetTest, NamesWhatItCouldNotRemoveUntilItIsGone) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone);
  const Traces traces = TracesOf(id);
  WriteText(folder_ / "notes.txt", "nice face in " + id + "\n");
  const auto report = ForgetNow({id});
  ASSERT_TRUE(report.ok());
  EXPECT_THAT(report->leftovers, ::testing::ElementsAre("notes.txt, offset 13: session id"));
  EXPECT_TRUE(*IsForgotten(folder_, id));
  EXPECT_EQ(CertificateOf(id)["verification"]["clean"], false);
  EXPECT_THAT(*UnfinishedForgets(folder_), ::testing::ElementsAre(id));
  fs::remove(folder_ / "notes.txt");
  EXPECT_THAT(ForgetNow({})->leftovers, IsEmpty());
  EXPECT_EQ(CertificateOf(id)["verification"]["clean"], true);
  ExpectGone(traces, kVisitor);
}

TEST_F(ForgetTest, AnExportThatCannotBeDeletedKeepsNoFrameAlive) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone);
  const Traces traces = TracesOf(id);
  const std::string marker = *ReadFile(ExportMarker(exports_ / id, id));
  WriteText(ExportMarker(exports_ / id, id), "{");  // stands for a folder on a read-only disk
  const auto report = ForgetNow({id});
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_EQ(report->sessions[0].exports[0].state, ExportState::kKept);
  ASSERT_EQ(report->leftovers.size(), 1U);
  EXPECT_THAT(report->leftovers[0], HasSubstr((exports_ / id).string()));
  EXPECT_FALSE(fs::exists(folder_ / "sessions" / id));
  EXPECT_THAT(*UnfinishedForgets(folder_), ::testing::ElementsAre(id));
  WriteText(ExportMarker(exports_ / id, id), marker);
  EXPECT_THAT(ForgetNow({})->leftovers, IsEmpty());
  EXPECT_FALSE(fs::exists(exports_ / id));
  ExpectGone(traces, kVisitor);
}

// Whoever exports while a forgetting goes on: what began before it is entered is found, what begins later is refused,
// and what it overtakes is deleted by the export itself.
TEST_F(ForgetTest, AnExportBesideAForgettingLeavesNothing) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone), other = Visit(kOther, 2, Encryption::kNone);
  Logger quiet(LogLevel::kError);
  Status early, late, overtaken;
  const auto extract = [&](const char* name) {
    const SessionStore store = OpenStore(AccessMode::kReadOnly);
    return ExtractFrames(store, id, *store.ListFrames(id), exports_ / name, quiet);
  };
  ForgetRequest request;
  request.sessions = {id};
  request.after_step = [&](ForgetStep step) {
    if (step == ForgetStep::kIntent) {
      early = extract("early");
      overtaken = WriteExport(folder_, "extract", id, exports_ / "overtaken", {"a.png"}, [&] {
        WriteText(exports_ / "overtaken" / "a.png", "a face");
        // As if the forgetting had come by here.
        EXPECT_TRUE(
            AppendToLedger(folder_, {LedgerKind::kForgetting, WallNow(), {id}, "", R"({"reason":"forget"})"}).ok());
        EXPECT_TRUE(RemoveExport(ExportPlace(exports_ / "overtaken"), id).ok());
        fs::create_directories(exports_ / "overtaken");
        WriteText(exports_ / "overtaken" / "a.png", "a face");
        return Status::Ok();
      });
    }
    if (step == ForgetStep::kExport) late = extract("late");
  };
  const auto report = Forget(folder_, request, quiet);
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_TRUE(early.ok()) << early.message();
  EXPECT_EQ(late.code(), StatusCode::kUsage) << late.message();
  EXPECT_EQ(overtaken.code(), StatusCode::kUsage) << overtaken.message();
  for (const char* name : {"early", "late", "overtaken"}) EXPECT_FALSE(fs::exists(exports_ / name / "a.png")) << name;
  EXPECT_FALSE(fs::exists(exports_ / "early"));
  EXPECT_TRUE(fs::exists(exports_ / other));
}

TEST_F(ForgetTest, TakesTheCopyFromBeforeAMigrationWithIt) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone);
  const Traces traces = TracesOf(id);
  ASSERT_TRUE(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)
                  ->Execute("VACUUM INTO '" + (folder_ / "index-before-2.sqlite").string() + "'")
                  .ok());
  WriteText(folder_ / "index-before-1.sqlite", "a copy that knows nothing of it");
  ASSERT_TRUE(ForgetNow({id}).ok());
  ExpectGone(traces, kVisitor);
  EXPECT_FALSE(fs::exists(folder_ / "index-before-2.sqlite"));
  EXPECT_TRUE(fs::exists(folder_ / "index-before-1.sqlite"));
}

TEST_F(ForgetTest, DoesNotReturnByReopeningImportOrKey) {
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession);
  const auto row = OpenStore(AccessMode::kReadOnly).FindSession(id);
  const fs::path copy = exports_ / "copy-by-hand";
  ASSERT_TRUE(ExportKeyFile(folder_, *row, exports_ / "carried.key").ok());
  fs::copy(exports_ / id, copy, fs::copy_options::recursive);
  fs::copy(exports_ / "carried.key", exports_ / "hidden.key");
  fs::copy(folder_ / "sessions" / id, exports_ / "session", fs::copy_options::recursive);
  ASSERT_TRUE(ForgetNow({id}).ok());
  EXPECT_FALSE(fs::exists(exports_ / "carried.key")) << "a logged key goes with its session";
  const auto refused = ImportKeyFile(folder_, exports_ / "hidden.key");
  EXPECT_EQ(refused.status().code(), StatusCode::kUsage);
  EXPECT_THAT(refused.status().message(), HasSubstr("forgotten"));

  WriteText(copy / "m.toml", R"([import]
rig = "r"
camera_width = 64
camera_height = 64
bit_depth = 12
projector_width = 1024
projector_height = 1024
[[file]]
file = "000000-gray-rows-bit-3-10-inverse.png"
pattern = "white"
)");
  SessionStore store = OpenStore();
  Logger quiet(LogLevel::kError);
  const auto imported = ImportSession(store, {copy / "m.toml", "", {}}, quiet);
  EXPECT_EQ(imported.status().code(), StatusCode::kUsage);
  EXPECT_THAT(imported.status().message(), HasSubstr("`stratalux-db deletions`"));
  fs::remove(ExportMarker(copy, id));
  EXPECT_TRUE(ImportSession(store, {copy / "m.toml", "", {}}, quiet).ok()) << "the marker alone was in its way";

  // Of an export the marker lies above the frames.
  const fs::path whole = exports_ / "whole";
  fs::create_directories(whole / "frames");
  fs::copy(copy / "000000-gray-rows-bit-3-10-inverse.png", whole / "frames" / "f.png");
  std::string toml = *ReadFile(copy / "m.toml");
  toml.replace(toml.find("000000-gray"), std::string("000000-gray-rows-bit-3-10-inverse.png").size(), "frames/f.png");
  WriteText(whole / "import.toml", toml);
  ASSERT_TRUE(WriteExportMarker(whole, id, {"frames/f.png"}).ok());
  EXPECT_EQ(ImportSession(store, {whole / "import.toml", "", {}}, quiet).status().code(), StatusCode::kUsage);
  WriteText(whole / "elsewhere.toml", toml);
  fs::rename(whole / "elsewhere.toml", exports_ / "elsewhere.toml");
  EXPECT_EQ(ImportSession(store, {exports_ / "elsewhere.toml", whole, {}}, quiet).status().code(), StatusCode::kUsage);

  // Its folder put back by hand is no session, and without the key no picture.
  fs::copy(exports_ / "session", folder_ / "sessions" / id, fs::copy_options::recursive);
  const SessionStore reopened = OpenStore();
  EXPECT_EQ(reopened.FindSession(id).status().code(), StatusCode::kNotFound);
  EXPECT_EQ(reopened.ListSessions()->size(), 1U);
}

TEST_F(ForgetTest, EitherTombstoneIsEnough) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone);
  EXPECT_FALSE(*IsForgotten(folder_, id));
  ASSERT_TRUE(ForgetNow({id}).ok());
  EXPECT_TRUE(*IsForgotten(folder_, id));
  fs::rename(folder_ / "ledger", folder_ / "lost");
  EXPECT_TRUE(*IsForgotten(folder_, id)) << "by the index";
  fs::rename(folder_ / "lost", folder_ / "ledger");
  fs::remove(folder_ / "index.sqlite");
  EXPECT_TRUE(*IsForgotten(folder_, id)) << "by the ledger";
  EXPECT_FALSE(*IsForgotten(folder_, "../index"));
}

TEST_F(ForgetTest, APlanChangesNoByte) {
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession);
  const RawFiles before = ReadRaw(folder_);
  ForgetRequest request;
  request.sessions = {id};
  const auto plan = PlanForget(folder_, request);
  ASSERT_TRUE(plan.ok());
  EXPECT_EQ(plan->sessions[0].frames, 6);
  EXPECT_GT(plan->sessions[0].files, 3);
  EXPECT_EQ(plan->sessions[0].exports[0].state, ExportState::kDeleted);
  RawFiles after = ReadRaw(folder_);
  after.erase("index.sqlite-shm");  // SQLite's, of any opening
  EXPECT_EQ(after["index.sqlite-wal"], "");
  after.erase("index.sqlite-wal");
  EXPECT_TRUE(after == before);
  EXPECT_TRUE(fs::exists(exports_ / id));
}

TEST_F(ForgetTest, WaitsForWritersAndReaders) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone);
  {
    SessionStore store = OpenStore();
    const auto writer = store.BeginSession(SimulatedVisit());
    EXPECT_EQ(ForgetNow({id}).status().code(), StatusCode::kBusy);
    EXPECT_FALSE(*IsForgotten(folder_, id)) << "not begun";
  }
  const Traces traces = TracesOf(id);
  {
    auto reader = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadOnly);
    ASSERT_TRUE(reader->Execute("BEGIN").ok());
    ASSERT_EQ(*reader->QueryInteger("SELECT count(*) FROM sessions"), 2);
    const Status status = ForgetNow({id}).status();
    EXPECT_EQ(status.code(), StatusCode::kBusy);
    EXPECT_THAT(status.message(), HasSubstr("forget --resume"));
  }
  ASSERT_TRUE(ForgetNow({}).ok());
  ExpectGone(traces, kVisitor);
}

// The bytes of the key by which the ledger names the visitor.
std::string VisitorKey(const fs::path& store, const std::string& visitor) {
  auto connection = Connection::Open(KeyFile(store), Connection::Mode::kReadOnly);
  auto select = connection->Prepare("SELECT key FROM visitor_keys WHERE pseudonym = ?1");
  select->Bind(1, visitor);
  if (!*select->Step()) return "";
  const auto bytes = select->Blob(0);
  return {bytes.begin(), bytes.end()};
}

TEST_F(ForgetTest, TheLedgersNameOfAVisitorDiesWithTheLastSession) {
  const std::string first = Visit(kVisitor, 1, Encryption::kNone), second = Visit(kVisitor, 2, Encryption::kNone);
  Visit(kOther, 3, Encryption::kNone);
  const std::string key = VisitorKey(folder_, kVisitor), name = *FindVisitorName(folder_, kVisitor);
  ASSERT_EQ(key.size(), 32U);
  ASSERT_TRUE(ForgetNow({first}).ok());
  EXPECT_EQ(*FindVisitorName(folder_, kVisitor), name) << "a session is left";
  ASSERT_TRUE(ForgetNow({second}).ok());
  EXPECT_EQ(FindVisitorName(folder_, kVisitor).status().code(), StatusCode::kNotFound);
  EXPECT_EQ(VisitorKey(folder_, kOther).size(), 32U);
  const RawFiles raw = ReadRaw(folder_);
  EXPECT_THAT(FilesWith(raw, key), IsEmpty());
  EXPECT_THAT(FilesWith(raw, kVisitor), IsEmpty());
  // The same pseudonym, given again, has another name: nobody can tell that it is the same.
  ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"2026-03", "de", true, true, false, {}}).ok());
  Visit(kVisitor, 4, Encryption::kNone);
  EXPECT_NE(*FindVisitorName(folder_, kVisitor), name);
}

TEST_F(ForgetTest, CleansWhatABrokenOffPullLeft) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone);
  const Traces traces = TracesOf(id);
  fs::create_directories(folder_ / "incoming");
  fs::copy(folder_ / "sessions" / id, folder_ / "incoming" / id, fs::copy_options::recursive);
  const auto report = ForgetNow({id});
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_THAT(report->leftovers, IsEmpty());
  ExpectGone(traces, kVisitor);
}

// The scan of a large store takes minutes; the next visitor does not wait for it.
TEST_F(ForgetTest, ACaptureBeginsWhileTheScanReads) {
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession);
  const Traces traces = TracesOf(id);
  int unlocked[2], captured[2];
  ASSERT_EQ(pipe(unlocked) + pipe(captured), 0);
  const pid_t child = fork();
  if (child == 0) {
    Logger quiet(LogLevel::kError);
    ForgetRequest request;
    request.sessions = {id};
    char go = 'u';
    bool is_unlocked = false;
    request.after_step = [&](ForgetStep step) {
      if (step == ForgetStep::kScanned && !is_unlocked) _exit(3);  // the scan kept captures waiting
      if (step != ForgetStep::kUnlocked) return;
      if (write(unlocked[1], &go, 1) != 1 || read(captured[0], &go, 1) != 1) _exit(2);
      is_unlocked = true;
    };
    const auto report = Forget(folder_, request, quiet);
    _exit(report.ok() && report->leftovers.empty() ? 0 : 1);
  }
  close(unlocked[1]);
  char go = 0;
  ASSERT_EQ(read(unlocked[0], &go, 1), 1) << "never unlocked before it scanned";
  EXPECT_TRUE(*IsForgotten(folder_, id));
  std::string next;
  {
    SessionStore store = OpenStore();
    SessionInfo info;
    info.visitor = kOther;
    auto writer = store.BeginSession(info, {.group_frames = 1});
    ASSERT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < 6; ++i) ASSERT_TRUE(AppendTo(*writer, i).ok());
    // The forget goes on, scans and certifies while the session is being written.
    ASSERT_EQ(write(captured[1], &go, 1), 1);
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_EQ(status, 0);
    ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    next = writer->info().id;
  }
  EXPECT_EQ(CertificateOf(id)["verification"]["clean"], true);
  EXPECT_THAT(*UnfinishedForgets(folder_), IsEmpty());
  {  // what SQLite's log still holds of the certificate goes into the index
    auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
    ASSERT_EQ(*connection->QueryInteger("PRAGMA wal_checkpoint(TRUNCATE)"), 0);
  }
  ExpectGone(traces, kVisitor);
  EXPECT_EQ(OpenStore(AccessMode::kReadOnly).ListFrames(next)->size(), 6U);
}

// Deleting a gigabyte takes a second, for which the next visitor does not wait either.
TEST_F(ForgetTest, FilesAreDeletedWithoutTheLock) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone);
  const Traces traces = TracesOf(id);
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    Logger quiet(LogLevel::kError);
    ForgetRequest request;
    request.sessions = {id};
    request.after_step = [&](ForgetStep step) {
      if (step == ForgetStep::kFile) _exit(2);
      if (step == ForgetStep::kUnlocked) _exit(WriteLock::TryTake(folder_).ok() ? 0 : 3);  // a kill at this moment
    };
    _exit(Forget(folder_, request, quiet).ok() ? 4 : 5);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  ASSERT_EQ(status, 0);
  EXPECT_FALSE(fs::exists(folder_ / "sessions" / id));
  EXPECT_TRUE(fs::exists(folder_ / "forgetting" / id));
  EXPECT_THAT(VerifyStore(OpenStore(AccessMode::kReadOnly))->problems,
              Contains(HasSubstr("stratalux-db forget --resume")));
  const auto again = ForgetNow({});
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_THAT(again->leftovers, IsEmpty());
  EXPECT_FALSE(fs::exists(folder_ / "forgetting"));
  ExpectGone(traces, kVisitor);
}

TEST_F(ForgetTest, WhatCannotBeSetAsideIsDeletedWhereItIs) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone);
  const Traces traces = TracesOf(id);
  WriteText(folder_ / "forgetting", "in the way\n");
  const auto report = ForgetNow({id});
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_FALSE(fs::exists(folder_ / "sessions" / id));
  EXPECT_TRUE(fs::exists(folder_ / "forgetting")) << "somebody else's";
  ExpectGone(traces, kVisitor);
}

// A page of the index may keep a copy of a row that it once moved elsewhere.
TEST_F(ForgetTest, RewritesAnIndexThatStillHoldsSomething) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone);
  const Traces traces = TracesOf(id);
  {
    // Stands for it: a row of nobody's that holds a payload hash, deleted without zeroing.
    auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
    ASSERT_TRUE(connection->Execute("PRAGMA secure_delete = OFF; CREATE TABLE stale (bytes BLOB)").ok());
    auto insert = connection->Prepare("INSERT INTO stale VALUES (?1)");
    const std::string& hash = traces.hashes[0];
    insert->Bind(1, std::span(reinterpret_cast<const uint8_t*>(hash.data()), hash.size()));
    ASSERT_TRUE(insert->Run().ok());
    ASSERT_TRUE(connection->Execute("DELETE FROM stale").ok());
    ASSERT_EQ(*connection->QueryInteger("PRAGMA wal_checkpoint(TRUNCATE)"), 0);
  }
  ASSERT_EQ(FilesWith(ReadRaw(folder_), traces.hashes[0])["index.sqlite"], 2) << "the frame's row and the stale copy";
  const auto report = ForgetNow({id});
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_THAT(report->leftovers, IsEmpty());
  ExpectGone(traces, kVisitor);
}

// Copies from before the session, or of a visitor whose sessions went one by one: neither id nor key, the name alone.
TEST_F(ForgetTest, OldCopiesOfTheIndexLoseTheNameOfAVisitorWhoIsGone) {
  const std::string brief = "v-7";
  ASSERT_TRUE(GiveConsent(folder_, brief, {"2026-03", "de", true, true, false, {}}).ok());
  const auto copy_as = [&](const std::string& name, const std::string& but) {
    auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
    ASSERT_TRUE(connection->Execute("VACUUM INTO '" + (folder_ / name).string() + "'").ok());
    auto copy = Connection::Open(folder_ / name, Connection::Mode::kReadWrite);
    for (const char* table : {"consents WHERE visitor", "visitors WHERE id"})
      ASSERT_TRUE(copy->Execute("DELETE FROM " + std::string(table) + " IN (" + but + ")").ok());
    ASSERT_TRUE(copy->Execute("VACUUM").ok());
  };
  const std::string long_name = "'" + std::string(kVisitor) + "'", short_name = "'" + brief + "'";
  copy_as("index-before-reindex-1.sqlite", short_name);
  copy_as("index-before-reindex-2.sqlite", long_name);
  copy_as("index-before-reindex-3.sqlite", long_name + ", " + short_name);
  WriteText(folder_ / "index-before-reindex-4.sqlite", "damaged, and its log is whole");
  WriteText(folder_ / "index-before-reindex-4.sqlite-wal", "of " + std::string(kVisitor));
  const std::string first = Visit(kVisitor, 1, Encryption::kNone), second = Visit(brief, 2, Encryption::kNone);
  ASSERT_TRUE(ForgetNow({first}).ok());
  for (const char* gone : {"1.sqlite", "4.sqlite", "4.sqlite-wal"})
    EXPECT_FALSE(fs::exists(folder_ / (std::string("index-before-reindex-") + gone))) << gone;
  for (const char* stays : {"2.sqlite", "3.sqlite"})
    EXPECT_TRUE(fs::exists(folder_ / (std::string("index-before-reindex-") + stays))) << stays;
  WriteText(folder_ / "index-before-reindex-5.sqlite", "damaged: whom it names nobody can tell");
  const auto report = ForgetNow({second});
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_FALSE(fs::exists(folder_ / "index-before-reindex-2.sqlite")) << "by its row";
  EXPECT_TRUE(fs::exists(folder_ / "index-before-reindex-3.sqlite"));
  EXPECT_THAT(report->leftovers, ::testing::ElementsAre(HasSubstr("index-before-reindex-5.sqlite: cannot be read")));
  fs::remove(folder_ / "index-before-reindex-5.sqlite");
  EXPECT_THAT(ForgetNow({})->leftovers, IsEmpty());
}

}  // namespace
}  // namespace stratalux::db
