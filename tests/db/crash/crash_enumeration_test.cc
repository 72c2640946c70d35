// SPDX-License-Identifier: Apache-2.0
// The power fails after every single write, sync, rename, ... of a night in small; no promise of the store may break.
#include <algorithm>
#include <set>

#include <gmock/gmock.h>

#include "db/base/sqlite.h"
#include "db/care/reindex.h"
#include "db/migration_0001.h"
#include "tests/db/crash/crash_fixture.h"
#include "tests/db/crash/enumeration.h"
#include "tests/db/crash/store_check.h"

namespace stratalux::db::crash {
namespace {

namespace fs = std::filesystem;
using Kind = DiskCall::Kind;

using CrashEnumeration = CrashTest;

// In the midst of a group, of a footer, of a truth map, and around the manifest's renaming.
std::vector<size_t> KillPoints(const DiskLog& log) {
  std::vector<size_t> points;
  for (size_t i = 0; i < log.calls.size(); ++i) {
    const DiskCall& call = log.calls[i];
    const bool manifest = call.kind == Kind::kLink && !call.old_name.empty() && call.name == "manifest.json";
    const bool spaced = i > 120 && i % 67 == 0 && i < log.calls.size() - 10;
    if (manifest || spaced) points.push_back(i + 1);
    if (manifest) points.push_back(i);
  }
  return points;
}

void ExpectNone(const EnumerationReport& report) {
  EXPECT_EQ(report.violations, 0);
  for (const std::string& v : report.first_violations) ADD_FAILURE() << v;
}

TEST_F(CrashEnumeration, TheRecorderSeesEveryChangeOfTheDisk) {
  DiskLog log;
  Record(log);
  Disk disk(log);
  for (const DiskCall& call : log.calls) disk.Apply(call);
  std::mt19937_64 random(1);
  DiskImage real = ReadImage(Store());
  std::erase_if(real, [](const auto& f) { return f.first.ends_with("-shm"); });
  const DiskImage replayed = disk.After(PowerCut::kKeepsAll, random);
  ASSERT_EQ(replayed.size(), real.size());
  for (const auto& [path, bytes] : real) {
    ASSERT_TRUE(replayed.contains(path)) << path;
    EXPECT_TRUE(replayed.at(path) == bytes) << path;
  }
}

TEST_F(CrashEnumeration, NoPromiseBreaksWhereverThePowerFails) {
  DiskLog log;
  const WorkloadReport workload = Record(log);
  const EnumerationReport report =
      Enumerate(log, workload.promises, Remains(), {.random_cuts = 2, .stride = SampledStride()});
  Print("power cuts", report);
  EXPECT_GT(report.points * SampledStride(), 300);
  ExpectNone(report);
}

TEST_F(CrashEnumeration, ARecoveryMayBeCutAnywhereToo) {
  DiskLog log;
  const WorkloadReport workload = Record(log);
  EnumerationReport sum;
  size_t mended = 0;
  // The writer is killed here and there, its bytes half in memory; then the power fails while the next opening mends.
  const auto kills = KillPoints(log);
  for (const size_t kill : kills) {
    Disk disk(log);
    int64_t promise = 0;
    for (size_t i = 0; i < kill; ++i) {
      disk.Apply(log.calls[i]);
      if (log.calls[i].kind == Kind::kMark) promise = log.calls[i].offset;
    }
    std::mt19937_64 random(kill);
    WriteImage(disk.After(PowerCut::kKeepsAll, random), Store());
    StartRecording(Store());
    std::vector<Promise> promises = workload.promises;
    Promise kept = promises[promise];
    {
      const auto store = SessionStore::Open(Store(), AccessMode::kReadWrite);
      ASSERT_TRUE(store.ok()) << store.status().message();
      mended += store->notes().empty() ? 0 : 1;
      for (SessionPromise& s : kept.sessions) s.ended = store->FindSession(s.id)->info.status;
      promises.push_back(kept);
      Mark(static_cast<int64_t>(promises.size()) - 1);
    }
    const DiskLog both = Continue(log, kill, StopRecording());
    Add(Enumerate(both, promises, Remains(), {.random_cuts = 1, .from_call = kill, .stride = SampledStride()}), sum);
  }
  Print("power cuts during " + std::to_string(kills.size()) + " recoveries", sum);
  EXPECT_GT(sum.points * SampledStride(), 100);
  EXPECT_GT(mended, kills.size() / 2) << "openings that found something to mend say so";
  ExpectNone(sum);
}

// A store of schema 1 with one session of one frame, as version 0.1 of the programs left it.
std::string StoreOfSchema1(const std::filesystem::path& folder) {
  std::string id;
  {
    EXPECT_TRUE(SessionStore::Create(folder).ok());
    auto store = SessionStore::Open(folder, AccessMode::kReadWrite);
    SessionInfo info;
    info.simulated = true;
    auto writer = store->BeginSession(info);
    id = writer->info().id;
    EXPECT_TRUE(AppendFrame(*writer, 0).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  }
  std::filesystem::rename(folder / "index.sqlite", folder / "newer");
  auto old = Connection::Open(folder / "index.sqlite", Connection::Mode::kCreate);
  EXPECT_TRUE(old->Execute("PRAGMA journal_mode = WAL").ok());
  EXPECT_TRUE(old->Execute(kMigration0001).ok());
  const Status copied = old->Execute(
      "ATTACH '" + (folder / "newer").string() +
      "' AS newer; INSERT INTO sessions SELECT number, id, kind, rig, visitor, consent, simulated, seed,"
      " started_wall_ns, status, reasons_json, program_version, plan_json, calibration_id FROM newer.sessions;"
      " INSERT INTO frames SELECT session, frame, segment, offset, stored_bytes, hash, step, projector, phase, pattern,"
      " retry, level_check FROM newer.frames; DETACH newer; PRAGMA application_id = 1397512241;"
      " PRAGMA user_version = 1");
  EXPECT_TRUE(copied.ok()) << copied.message();
  old = Status::Failed("closed");
  std::filesystem::remove(folder / "newer");
  return id;
}

TEST_F(CrashEnumeration, AMigrationMayBeCutAnywhereToo) {
  const std::string id = StoreOfSchema1(Store());
  StartRecording(Store());
  Promise promise;
  promise.created = true;
  promise.sessions.push_back({id, 1, SessionStatus::kComplete, {}});
  {
    const auto store = SessionStore::Open(Store(), AccessMode::kReadWrite);
    ASSERT_TRUE(store.ok()) << store.status().message();
  }
  const DiskLog log = StopRecording();
  // An index of schema 1 knows no proofs and no consents, and verify says so; a reindex fills it in from the files.
  Logger quiet(LogLevel::kError);
  const CheckFunction check = [&](const fs::path& folder, int64_t, CheckCounts& counts) {
    std::vector<std::string> broken;
    {
      const auto store = SessionStore::Open(folder, AccessMode::kReadWrite);
      const auto frames = store.ok() ? store->ListFrames(id) : store.status();
      const auto image = frames.ok() && frames->size() == 1 ? store->ReadFrame(id, (*frames)[0]) : frames.status();
      if (!image.ok() || !HasPixelsOf(*image, 0)) broken.push_back("the frame is gone: " + image.status().message());
    }
    if (const auto rebuilt = Reindex(folder, quiet); !rebuilt.ok()) broken.push_back(rebuilt.status().message());
    for (std::string& line : CheckStore(folder, promise, counts)) broken.push_back(std::move(line));
    return broken;
  };
  const auto report = Enumerate(log, check, Remains(), {.random_cuts = 1, .stride = SampledStride()});
  Print("power cuts during a migration", report);
  EXPECT_GT(report.points * SampledStride(), 30);
  EXPECT_TRUE(std::filesystem::exists(Store() / ("index-before-" + std::to_string(kSchemaVersion) + ".sqlite")));
  ExpectNone(report);
}

// ---- The enumeration must be able to fail: each guarantee is taken away in turn.

// Whose sync, by a part of the path it was created or renamed under.
std::set<Inode> InodesNamed(const DiskLog& log, const std::string& part) {
  std::set<Inode> inodes;
  for (const DiskCall& call : log.calls)
    if (call.kind == Kind::kLink && call.name.find(part) != std::string::npos) inodes.insert(call.file);
  return inodes;
}

DiskLog WithoutSyncsOf(DiskLog log, const std::set<Inode>& inodes) {
  std::erase_if(log.calls, [&](const DiskCall& c) { return c.kind == Kind::kSync && inodes.contains(c.file); });
  return log;
}

class BrokenOrder : public CrashTest {
 protected:
  void SetUp() override {
    CrashTest::SetUp();
    workload_ = Record(log_);
  }
  void ExpectFound(const std::string& what, const DiskLog& log) {
    // From the first session on.
    size_t start = 0;
    while (log.calls[start].kind != Kind::kMark || log.calls[start].offset != 1) ++start;
    const auto report = Enumerate(log, workload_.promises, Remains(),
                                  {.random_cuts = 1, .until_first_violation = true, .from_call = start});
    ASSERT_GT(report.violations, 0) << what;
    std::printf("%s: found at point %lld: %s\n", what.c_str(), static_cast<long long>(report.points),
                report.first_violations[0].c_str());
  }

  DiskLog log_;
  WorkloadReport workload_;
};

TEST_F(BrokenOrder, SegmentsWithoutSyncAreFound) {
  ExpectFound("no sync of segments", WithoutSyncsOf(log_, InodesNamed(log_, "frames-")));
}

TEST_F(BrokenOrder, AnIndexWithoutSyncIsFound) {
  ExpectFound("no sync of SQLite's log", WithoutSyncsOf(log_, InodesNamed(log_, "index.sqlite-wal")));
}

TEST_F(BrokenOrder, AnUnsyncedManifestIsFound) {
  ExpectFound("no sync of manifests", WithoutSyncsOf(log_, InodesNamed(log_, "manifest.json")));
}

TEST_F(BrokenOrder, AnUnsyncedFitIsFound) {
  ExpectFound("no sync of fits", WithoutSyncsOf(log_, InodesNamed(log_, ".exr")));
}

TEST_F(BrokenOrder, UnsyncedFoldersAreFound) {
  ExpectFound("no sync of sessions/", WithoutSyncsOf(log_, InodesNamed(log_, "sessions")));
  ExpectFound("no sync of a session's folder", WithoutSyncsOf(log_, InodesNamed(log_, "s00000")));
}

TEST_F(BrokenOrder, ACommitBeforeTheSyncOfItsBytesIsFound) {
  // Each sync of a segment moves behind the next one of SQLite's log: the row is durable before its bytes.
  const auto segments = InodesNamed(log_, "frames-"), wals = InodesNamed(log_, "index.sqlite-wal");
  DiskLog swapped = log_;
  swapped.calls.clear();
  std::vector<DiskCall> late;
  for (const DiskCall& call : log_.calls) {
    if (call.kind == Kind::kSync && segments.contains(call.file)) {
      late.push_back(call);
      continue;
    }
    swapped.calls.push_back(call);
    if (call.kind == Kind::kSync && wals.contains(call.file)) {
      swapped.calls.insert(swapped.calls.end(), late.begin(), late.end());
      late.clear();
    }
  }
  ExpectFound("commit before sync", swapped);
}

TEST_F(BrokenOrder, AnAcknowledgementBeforeTheCommitIsFound) {
  DiskLog early = log_;
  for (size_t i = 1; i < early.calls.size(); ++i)
    if (early.calls[i].kind == Kind::kMark)
      std::rotate(early.calls.begin() + (i < 12 ? 0 : i - 12), early.calls.begin() + i, early.calls.begin() + i + 1);
  ExpectFound("acknowledged before the commit", early);
}

}  // namespace
}  // namespace stratalux::db::crash
