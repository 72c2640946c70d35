// SPDX-License-Identifier: Apache-2.0
// The power fails after every single write, sync, rename, ... of what operators do to a store: encrypted captures
// (keys), withdrawals and forgettings (ledger), reindex, transcode, restore, pull. Whatever is left opens, holds what
// was promised by then, and the same command, given again, ends where the undisturbed one does.
#include <gmock/gmock.h>

#include "db/care/reindex.h"
#include "db/care/transcode.h"
#include "db/care/verify.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/deletions.h"
#include "db/privacy/export_marker.h"
#include "db/privacy/forget.h"
#include "db/transfer/backup.h"
#include "db/transfer/pull.h"
#include "tests/db/crash/crash_fixture.h"
#include "tests/db/crash/enumeration.h"
#include "tests/support/text_file.h"

namespace stratalux::db::crash {
namespace {

namespace fs = std::filesystem;
using Findings = std::vector<std::string>;

struct Kept {
  std::string id;
  int frames = 0, first_step = 0;
};

class VerbCrash : public CrashTest {
 protected:
  void SetUp() override {
    CrashTest::SetUp();
    ASSERT_TRUE(SessionStore::Create(Store()).ok());
    first_ = Write(Store(), "v-1a1a1a1a", 7, 0, Encryption::kNone);
    sealed_ = Write(Store(), "v-2b2b2b2b", 5, 100, Encryption::kPerSession);
    last_ = Write(Store(), "v-3c3c3c3c", 4, 200, Encryption::kNone);
  }

  // A finished session of several groups and segments, in which no opening finds anything to mend.
  static Kept Write(const fs::path& folder, const std::string& visitor, int frames, int first_step,
                    Encryption encryption) {
    auto store = SessionStore::Open(folder, AccessMode::kReadWrite);
    EXPECT_TRUE(store.ok()) << store.status().message();
    EXPECT_TRUE(GiveConsent(folder, visitor, {"2026-01", "de", true, false, false, {1}}).ok());
    SessionInfo info;
    info.rig = "bench";
    info.simulated = true;
    info.visitor = visitor;
    auto writer = store->BeginSession(info, {.group_frames = 3,
                                             .group_window = std::chrono::hours(1),
                                             .max_segment_bytes = 9'000,
                                             .encryption = encryption});
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < frames; ++i) EXPECT_TRUE(AppendFrame(*writer, first_step + i).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    return {writer->info().id, frames, first_step};
  }

  // The calls that `verb` makes below STORE; mark 1 stands where it had returned.
  template <typename F>
  DiskLog RecordVerb(F&& verb) {
    StartRecording(Store());
    verb();
    Mark(1);
    return StopRecording();
  }

  static void Expect(Findings& broken, const Status& status, const std::string& what) {
    if (!status.ok()) broken.push_back(what + ": " + status.message());
  }

  // Each session is listed, whole, and of the right pixels; `readable`: with its key.
  static void ExpectWhole(const fs::path& folder, const std::vector<Kept>& sessions, Findings& broken,
                          CheckCounts& counts) {
    auto store = SessionStore::Open(folder, AccessMode::kReadWrite);
    if (!store.ok()) return Expect(broken, store.status(), "open");
    ++counts.stores;
    for (const Kept& kept : sessions) {
      const auto row = store->FindSession(kept.id);
      if (!row.ok()) {
        Expect(broken, row.status(), "find");
        continue;
      }
      ++counts.sessions;
      if (row->info.status != SessionStatus::kComplete) broken.push_back(kept.id + " is no longer complete");
      const auto report = VerifySession(*store, *row);
      if (!report.ok()) Expect(broken, report.status(), "verify");
      if (report.ok()) broken.insert(broken.end(), report->problems.begin(), report->problems.end());
      const auto frames = store->ListFrames(kept.id);
      if (!frames.ok() || frames->size() != static_cast<size_t>(kept.frames)) {
        broken.push_back(kept.id + " has not its " + std::to_string(kept.frames) + " frames");
        continue;
      }
      for (const FrameRow& frame : *frames) {
        ++counts.frames;
        const auto image = store->ReadFrame(kept.id, frame);
        if (!image.ok()) Expect(broken, image.status(), "read");
        if (image.ok() && !HasPixelsOf(*image, kept.first_step + static_cast<int>(frame.id)))
          broken.push_back(kept.id + ": wrong pixels in frame " + std::to_string(frame.id));
      }
    }
  }

  void ExpectNone(const std::string& title, const EnumerationReport& report, int64_t least_points) const {
    Print(title, report);
    EXPECT_GT((report.points + 1) * SampledStride(), least_points);
    EXPECT_EQ(report.violations, 0);
    for (const std::string& v : report.first_violations) ADD_FAILURE() << v;
  }

  Kept first_, sealed_, last_;
  Logger logger_{LogLevel::kError};
  const EnumerationOptions options_{.random_cuts = 1, .stride = SampledStride()};
};

TEST_F(CrashTest, AnEncryptedNightKeepsItsKeysWhereverThePowerFails) {
  DiskLog log;
  const WorkloadReport workload = Record(log, Encryption::kPerSession);
  const EnumerationReport report =
      Enumerate(log, workload.promises, Remains(), {.random_cuts = 1, .stride = SampledStride()});
  Print("power cuts of encrypted captures", report);
  EXPECT_GT(report.points * SampledStride(), 300);
  EXPECT_EQ(report.violations, 0);
  for (const std::string& v : report.first_violations) ADD_FAILURE() << v;
}

TEST_F(VerbCrash, AWithdrawalIsWholeOrNotThere) {
  const DiskLog log = RecordVerb([this] { ASSERT_TRUE(WithdrawConsent(Store(), "v-1a1a1a1a").ok()); });
  const CheckFunction check = [this](const fs::path& folder, int64_t mark, CheckCounts& counts) {
    Findings broken;
    ExpectWhole(folder, {first_, sealed_, last_}, broken, counts);
    const bool holds = ValidConsent(folder, "v-1a1a1a1a").ok();
    if (mark == 1 && holds) broken.push_back("the withdrawal is gone");
    // The index is lost: what was withdrawn stays withdrawn.
    for (const char* suffix : {"", "-wal", "-shm"}) fs::remove(folder / (std::string("index.sqlite") + suffix));
    Expect(broken, Reindex(folder, logger_).status(), "reindex");
    if (!holds && ValidConsent(folder, "v-1a1a1a1a").ok()) broken.push_back("a reindex brought the consent back");
    return broken;
  };
  ExpectNone("power cuts of a withdrawal", Enumerate(log, check, Remains(), options_), 8);
}

TEST_F(VerbCrash, AForgettingThatBeganEndsAndNeverReturns) {
  for (const Kept& gone : {first_, sealed_}) {
    const DiskLog log = RecordVerb([&] {
      const auto report = Forget(Store(), {.sessions = {gone.id}, .visitors = {}, .after_step = {}}, logger_);
      ASSERT_TRUE(report.ok()) << report.status().message();
    });
    const std::vector<Kept> others =
        gone.id == first_.id ? std::vector<Kept>{sealed_, last_} : std::vector<Kept>{last_};
    const CheckFunction check = [&](const fs::path& folder, int64_t mark, CheckCounts& counts) {
      Findings broken;
      ExpectWhole(folder, others, broken, counts);
      const auto forgotten = IsForgotten(folder, gone.id);
      Expect(broken, forgotten.status(), "is forgotten");
      if (mark == 1 && forgotten.ok() && !*forgotten) broken.push_back(gone.id + " may return");
      if (forgotten.ok() && !*forgotten) ExpectWhole(folder, {gone}, broken, counts);
      if (forgotten.ok() && *forgotten) {
        const auto resumed = Forget(folder, {.sessions = {}, .visitors = {}, .after_step = {}}, logger_);
        Expect(broken, resumed.status(), "resume");
        if (resumed.ok()) broken.insert(broken.end(), resumed->leftovers.begin(), resumed->leftovers.end());
        if (fs::exists(folder / "sessions" / gone.id)) broken.push_back(gone.id + " has its folder still");
        for (const char* suffix : {"", "-wal", "-shm"}) fs::remove(folder / (std::string("index.sqlite") + suffix));
        Expect(broken, Reindex(folder, logger_).status(), "reindex");
        ExpectWhole(folder, others, broken, counts);
        const auto store = SessionStore::Open(folder, AccessMode::kReadOnly);
        if (store.ok() && store->FindSession(gone.id).ok()) broken.push_back(gone.id + " came back with a reindex");
        const auto still = IsForgotten(folder, gone.id);
        if (!still.ok() || !*still) broken.push_back(gone.id + " may return after a reindex");
      }
      return broken;
    };
    ExpectNone("power cuts of a forgetting", Enumerate(log, check, Remains(), options_), 60);
  }
}

// The certificate that follows calls it deleted, and nobody looks for it again.
TEST_F(VerbCrash, AnExportThatWasDeletedStaysDeleted) {
  const std::vector<std::string> names = {"small.key", "deep/er/large.png"};
  const fs::path out = Store() / "out";
  ASSERT_TRUE(WriteExportMarker(out, first_.id, names).ok());
  fs::create_directories(out / "deep" / "er");
  WriteText(out / "small.key", "a key");
  WriteText(out / "deep" / "er" / "large.png", std::string(9'000, 'x'));
  WriteText(out / "deep" / "thesis.txt", "mine");
  const DiskLog log = RecordVerb([&] {
    const auto state = RemoveExport(ExportPlace(out), first_.id);
    ASSERT_TRUE(state.ok()) << state.status().message();
    ASSERT_EQ(*state, ExportState::kDeleted);
  });
  const CheckFunction check = [&](const fs::path& folder, int64_t mark, CheckCounts& counts) {
    Findings broken;
    ++counts.stores;
    const bool marked = fs::exists(ExportMarker(folder / "out", first_.id));
    if (mark == 1 && marked) broken.push_back("the marker is back");
    for (const std::string& name : names)
      if (!marked && fs::exists(folder / "out" / name)) broken.push_back(name + " is back, and nothing names it");
    if (!fs::exists(folder / "out" / "deep" / "thesis.txt")) broken.push_back("somebody else's file is gone");
    return broken;
  };
  ExpectNone("power cuts of an export's deletion", Enumerate(log, check, Remains(), {.random_cuts = 3, .stride = 1}),
             6);
}

TEST_F(VerbCrash, AReindexLeavesAnIndexOldOrNew) {
  const DiskLog log = RecordVerb([this] { ASSERT_TRUE(Reindex(Store(), logger_).ok()); });
  const CheckFunction check = [this](const fs::path& folder, int64_t, CheckCounts& counts) {
    Findings broken;
    ExpectWhole(folder, {first_, sealed_, last_}, broken, counts);
    Expect(broken, Reindex(folder, logger_).status(), "reindex again");
    ExpectWhole(folder, {first_, sealed_, last_}, broken, counts);
    return broken;
  };
  ExpectNone("power cuts of a reindex", Enumerate(log, check, Remains(), options_), 30);
}

TEST_F(VerbCrash, ATranscodeLosesNoPixel) {
  const DiskLog log = RecordVerb([this] {
    const auto store = SessionStore::Open(Store(), AccessMode::kReadWrite);
    Progress progress(logger_, "transcode", 1);
    TranscodeOptions options;
    options.codec = StoreCodec::kRaw12;
    options.max_segment_bytes = 9'000;
    const auto report = TranscodeSession(*store, *store->FindSession(first_.id), options, progress);
    ASSERT_TRUE(report.ok()) << report.status().message();
    ASSERT_GT(report->changed, 0);
  });
  const CheckFunction check = [this](const fs::path& folder, int64_t, CheckCounts& counts) {
    Findings broken;
    ExpectWhole(folder, {first_, sealed_, last_}, broken, counts);
    return broken;
  };
  ExpectNone("power cuts of a transcode", Enumerate(log, check, Remains(), options_), 30);
}

// The store of the fixture serves as what is restored or pulled from; STORE is then another one.
class ArrivalCrash : public VerbCrash {
 protected:
  void SetUp() override {
    VerbCrash::SetUp();
    fs::rename(Store(), Source());
    fs::create_directory(Store());
  }
  [[nodiscard]] fs::path Source() const { return folder_ / "source"; }
  [[nodiscard]] fs::path Copy() const { return folder_ / "backup"; }
  void MakeBackup() {
    const auto report = Backup(Source(), {.to = Copy(), .keys = {}}, logger_);
    ASSERT_TRUE(report.ok()) << report.status().message();
  }
  // Of a session whose key stayed at the source the bytes alone can be checked.
  void ExpectArrived(const fs::path& folder, Findings& broken, CheckCounts& counts) const {
    ExpectWhole(folder, {first_, last_}, broken, counts);
    const auto store = SessionStore::Open(folder, AccessMode::kReadOnly);
    if (!store.ok()) return Expect(broken, store.status(), "open");
    const auto row = store->FindSession(sealed_.id);
    if (!row.ok()) return Expect(broken, row.status(), "find");
    const auto report = VerifySession(*store, *row);
    if (report.ok()) broken.insert(broken.end(), report->problems.begin(), report->problems.end());
  }
};

TEST_F(ArrivalCrash, ARestoreIntoANewStoreIsContinued) {
  MakeBackup();
  const auto restore = [this](const fs::path& into) {
    return Restore(Copy(), into, {RestoreInto::kNewStore, kNoLedger}, logger_).status();
  };
  const DiskLog log = RecordVerb([&] { ASSERT_TRUE(restore(Store()).ok()); });
  const CheckFunction check = [&](const fs::path& folder, int64_t mark, CheckCounts& counts) {
    Findings broken;
    // Until the index is there the restore goes on; once it is, all it lists is whole.
    if (mark == 0 && !fs::exists(folder / "index.sqlite")) Expect(broken, restore(folder), "restore again");
    ExpectArrived(folder, broken, counts);
    return broken;
  };
  ExpectNone("power cuts of a restore", Enumerate(log, check, Remains(), options_), 60);
}

TEST_F(ArrivalCrash, AMergingRestoreIsContinued) {
  MakeBackup();
  ASSERT_TRUE(SessionStore::Create(Store()).ok());
  const Kept own = Write(Store(), "v-4d4d4d4d", 4, 300, Encryption::kNone);
  const auto restore = [this](const fs::path& into) {
    return Restore(Copy(), into, {RestoreInto::kMerge, ""}, logger_).status();
  };
  const DiskLog log = RecordVerb([&] { ASSERT_TRUE(restore(Store()).ok()); });
  const CheckFunction check = [&](const fs::path& folder, int64_t mark, CheckCounts& counts) {
    Findings broken;
    ExpectWhole(folder, {own}, broken, counts);
    if (mark == 0) Expect(broken, restore(folder), "restore again");
    ExpectArrived(folder, broken, counts);
    return broken;
  };
  ExpectNone("power cuts of a merging restore", Enumerate(log, check, Remains(), options_), 60);
}

TEST_F(ArrivalCrash, APullIsContinued) {
  ASSERT_TRUE(SessionStore::Create(Store()).ok());
  const Kept own = Write(Store(), "v-4d4d4d4d", 4, 300, Encryption::kNone);
  const auto pull = [this](const fs::path& into) {
    const auto report = Pull(into, Source().string(), {}, logger_);
    if (!report.ok()) return report.status();
    return report->problems.empty() ? Status::Ok() : Status::Failed(report->problems[0]);
  };
  const DiskLog log = RecordVerb([&] {
    const Status pulled = pull(Store());
    ASSERT_TRUE(pulled.ok()) << pulled.message();
  });
  const CheckFunction check = [&](const fs::path& folder, int64_t mark, CheckCounts& counts) {
    Findings broken;
    ExpectWhole(folder, {own}, broken, counts);
    if (mark == 0) Expect(broken, pull(folder), "pull again");
    ExpectArrived(folder, broken, counts);
    return broken;
  };
  ExpectNone("power cuts of a pull", Enumerate(log, check, Remains(), options_), 60);
}

}  // namespace
}  // namespace stratalux::db::crash
