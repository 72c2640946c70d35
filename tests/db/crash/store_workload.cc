// SPDX-License-Identifier: Apache-2.0
#include "tests/db/crash/store_workload.h"

#include <algorithm>
#include <fstream>

#include "db/base/sqlite.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/fit_reader.h"
#include "tests/db/crash/disk_recorder.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db::crash {
namespace {

// Some five frames a segment and three groups to two segments: ends of groups, segments and 4 KiB blocks differ.
WriterOptions OptionsWith(Encryption encryption) {
  return {
      .group_frames = 3, .group_window = std::chrono::hours(1), .max_segment_bytes = 20'000, .encryption = encryption};
}

class Workload {
 public:
  Workload(std::filesystem::path folder, Encryption encryption)
      : folder_(std::move(folder)), options_(OptionsWith(encryption)) {
    Promised();
  }

  WorkloadReport Run() {
    if (!Note(SessionStore::Create(folder_))) return report_;
    now_.created = true;
    Promised();
    WithStore([this](SessionStore& store) {
      WriteSession(store, 13, SessionStatus::kComplete);
      RegisterFit(store);
      WriteSession(store, 8, std::nullopt);
    });
    WithStore([this](SessionStore& store) {
      NoteRecovery(store);
      WriteSession(store, 5, SessionStatus::kDegraded);
    });
    return report_;
  }

 private:
  bool Note(const Status& status) {
    if (!status.ok()) report_.failures.push_back(status);
    return status.ok();
  }
  void Promised() {
    report_.promises.push_back(now_);
    Mark(static_cast<int64_t>(report_.promises.size()) - 1);
  }

  template <typename F>
  void WithStore(F&& use) {
    auto store = SessionStore::Open(folder_, AccessMode::kReadWrite);
    if (!Note(store.status())) return;
    report_.notes.insert(report_.notes.end(), store->notes().begin(), store->notes().end());
    use(*store);
  }

  // Without an ending the writer goes away as a killed process does: frames appended, a group unfinished.
  void WriteSession(SessionStore& store, int frames, std::optional<SessionStatus> ending) {
    const int first_step = 100 * static_cast<int>(now_.sessions.size());
    SessionInfo info;
    info.rig = "bench";
    info.simulated = true;
    info.visitor = "v-" + std::to_string(first_step);
    if (!Note(GiveConsent(folder_, info.visitor, {"2026-01", "de", true, false, false, {1}}))) return;
    auto writer = store.BeginSession(info, options_);
    if (!Note(writer.status())) return;
    now_.sessions.push_back({writer->info().id, 0, {}, {}});
    SessionPromise& promise = now_.sessions.back();
    Promised();
    for (int i = 0; i < frames; ++i) {
      if (i == 2) (void)writer->AppendTruth("depth", Image<float>(16, 16, 1, 0.5F).view()).ok();
      if (i == 4) Checkpoint();
      if (!Note(AppendFrame(*writer, first_step + i))) break;
      if (promise.acknowledged == writer->acknowledged_frames()) continue;
      promise.acknowledged = writer->acknowledged_frames();
      Promised();
    }
    if (!ending || !Note(writer->Finish(*ending, {"of the workload"}))) return;
    promise.acknowledged = frames;
    promise.ended = ending;
    Promised();
  }

  // As SQLite does by itself after a thousand pages.
  void Checkpoint() {
    auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
    if (connection.ok()) (void)connection->Execute("PRAGMA wal_checkpoint(RESTART)").ok();
  }

  static bool WriteFitFile(FileSeal& seal, const std::string& place, const std::filesystem::path& file) {
    const std::filesystem::path plain = seal.active() ? std::filesystem::path(file.string() + ".plain") : file;
    if (!(std::ofstream(plain) << kFitText).flush().good()) return false;
    return !seal.active() || (seal.Seal(plain, place, file).ok() && std::filesystem::remove(plain));
  }
  // Written and renamed as the fitter does: without a sync of its own.
  void RegisterFit(SessionStore& store) {
    if (now_.sessions.empty() || !now_.sessions[0].ended) return;
    const std::string id = now_.sessions[0].id;
    const auto folder = store.FitFolder(id, "f1"), partial = store.FitFolder(id, "f1.partial");
    std::error_code error;
    std::filesystem::create_directories(partial / "report", error);
    auto seal = FindSeal(store, id);
    bool written = Note(seal.status());
    for (const std::string name : {"position.exr", "report/index.html"})
      written = written && WriteFitFile(*seal, "fits/f1/" + name, partial / name);
    if (written) std::filesystem::rename(partial, folder, error);
    if (!written || error || !Note(store.RegisterFit({"f1", id, "{}", "{}", {5}}))) return;
    now_.sessions[0].fit = "f1";
    Promised();
  }

  // The abandoned session counts as ended once the opening said so.
  void NoteRecovery(SessionStore& store) {
    const auto rows = store.ListSessions();
    if (!Note(rows.status())) return;
    for (SessionPromise& promise : now_.sessions)
      for (const SessionSummary& row : *rows)
        if (row.info.id == promise.id && row.info.status != SessionStatus::kRecording) promise.ended = row.info.status;
    Promised();
  }

  std::filesystem::path folder_;
  WriterOptions options_;
  Promise now_;
  WorkloadReport report_;
};

FrameRecord RecordOf(int step) { return RecordFor(step, PixelFormat::kMono12, 64, 40); }

}  // namespace

WorkloadReport RunWorkload(const std::filesystem::path& folder, Encryption encryption) {
  return Workload(folder, encryption).Run();
}

Status AppendFrame(SessionWriter& writer, int step) {
  const FrameRecord record = RecordOf(step);
  const Image<uint16_t> pixels = PixelsFor(record);
  return writer.Append(record, pixels.view());
}

bool HasPixelsOf(const Image<uint16_t>& image, int step) {
  const Image<uint16_t> pixels = PixelsFor(RecordOf(step));
  return image.width() == pixels.width() && image.height() == pixels.height() &&
         std::equal(image.pixels().begin(), image.pixels().end(), pixels.pixels().begin());
}

}  // namespace stratalux::db::crash
