// SPDX-License-Identifier: Apache-2.0
#include "tests/db/crash/store_check.h"

#include <fstream>
#include <iterator>
#include <set>

#include "db/base/sqlite.h"
#include "db/care/verify.h"
#include "db/catalogue/fit_reader.h"
#include "tests/db/crash/disk_recorder.h"
#include "tests/support/text_file.h"

namespace stratalux::db::crash {
namespace {

class Checker {
 public:
  Checker(std::filesystem::path folder, const Promise& promise, CheckCounts& counts)
      : folder_(std::move(folder)), promise_(promise), counts_(counts) {}

  std::vector<std::string> Run() {
    ++counts_.stores;
    // Where creating the store had not returned, it is created (again).
    if (!promise_.created && !Ok("create", SessionStore::Create(folder_))) return broken_;
    Opened([this](const SessionStore& store) {
      CheckIndex();
      CheckSessions(store);
    });
    const auto before = Files();
    Opened([this](const SessionStore& store) { CheckSessions(store); });
    if (Files() != before) broken_.push_back("a second opening changed the store");
    Opened([this](SessionStore& store) { CheckNewSession(store); });
    return broken_;
  }

 private:
  bool Ok(const std::string& what, const Status& status) {
    if (!status.ok()) broken_.push_back(what + ": " + status.message());
    return status.ok();
  }
  void Expect(bool holds, const std::string& what) {
    if (!holds) broken_.push_back(what);
  }

  template <typename F>
  void Opened(F&& use) {
    auto store = SessionStore::Open(folder_, AccessMode::kReadWrite);
    if (Ok("open", store.status())) use(*store);
  }

  // Without what SQLite makes and removes at each opening.
  [[nodiscard]] DiskImage Files() const {
    DiskImage image = ReadImage(folder_);
    std::erase_if(image, [](const auto& f) { return f.first.ends_with("-wal") || f.first.ends_with("-shm"); });
    return image;
  }

  void CheckIndex() {
    auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadOnly);
    if (!Ok("index", connection.status())) return;
    auto check = connection->Prepare("PRAGMA integrity_check");
    if (!Ok("index", check.status()) || !Ok("index", check->Step().status())) return;
    Expect(check->Text(0) == "ok", "integrity_check: " + check->Text(0));
    const auto orphans = connection->QueryInteger("SELECT count(*) FROM pragma_foreign_key_check");
    Expect(orphans.ok() && *orphans == 0, "rows without their session");
    const auto totals = connection->QueryInteger(
        "SELECT count(*) FROM sessions s WHERE frame_count <> (SELECT count(*) FROM frames f WHERE f.session = "
        "s.number)"
        " OR (SELECT count(*) FROM proofs p WHERE p.session = s.number) NOT IN (frame_count, 0)"
        " OR stored_bytes <> (SELECT coalesce(sum(stored_bytes), 0) FROM frames f WHERE f.session = s.number)");
    Expect(totals.ok() && *totals == 0, "totals of a session disagree with its rows");
  }

  void CheckSessions(const SessionStore& store) {
    const auto rows = store.ListSessions();
    if (!Ok("list", rows.status())) return;
    std::set<std::string> ids;
    for (const SessionSummary& row : *rows) {
      ids.insert(row.info.id);
      ++counts_.sessions;
      Expect(row.info.status != SessionStatus::kRecording, row.info.id + " is still recording");
      CheckFrames(store, row);
      const auto whole = store.FindSession(row.info.id);
      if (!Ok("find", whole.status())) continue;
      const auto report = VerifySession(store, *whole);
      if (!Ok("verify", report.status())) continue;
      for (const std::string& problem : report->problems) broken_.push_back("verify: " + problem);
    }
    for (const SessionPromise& s : promise_.sessions) {
      Expect(ids.contains(s.id), s.id + " is gone");
      const auto row = store.FindSession(s.id);
      if (!row.ok()) continue;
      Expect(!s.ended || row->info.status == *s.ended, s.id + " ended otherwise than it was said");
      Expect(row->frames >= s.acknowledged, s.id + ": " + std::to_string(row->frames) + " frames of " +
                                                std::to_string(s.acknowledged) + " acknowledged ones");
      if (s.fit) CheckFit(store, s);
    }
  }

  // Frames are numbered without a gap, so that the acknowledged ones are the first ones.
  void CheckFrames(const SessionStore& store, const SessionSummary& row) {
    const auto frames = store.ListFrames(row.info.id);
    if (!Ok("frames", frames.status())) return;
    for (size_t i = 0; i < frames->size(); ++i) {
      const FrameRow& f = (*frames)[i];
      ++counts_.frames;
      Expect(f.id == static_cast<int64_t>(i) && f.record.step % 100 == static_cast<int>(i),
             row.info.id + ": frame " + std::to_string(i) + " is another one");
      const auto image = store.ReadFrame(row.info.id, f);
      if (Ok("read", image.status()))
        Expect(HasPixelsOf(*image, f.record.step), row.info.id + ": wrong pixels in frame " + std::to_string(i));
    }
  }

  void CheckFit(const SessionStore& store, const SessionPromise& s) {
    const auto fits = store.ListFits(s.id);
    if (!Ok("fits", fits.status())) return;
    Expect(fits->size() == 1 && (*fits)[0].id == *s.fit, s.id + ": the fit's row is gone");
    auto seal = FindSeal(store, s.id);
    if (!Ok("seal", seal.status())) return;
    auto reader = FitReader::Open(store.FitFolder(s.id, *s.fit), s.id, std::move(*seal));
    if (!Ok("fit", reader.status())) return;
    for (const char* name : {"position.exr", "report/index.html"}) {
      const auto file = reader->Read(name);
      if (!Ok("file of the fit", file.status())) continue;
      Expect(ReadText(file->path) == kFitText, s.id + ": " + name + " of the registered fit is not whole");
    }
  }

  void CheckNewSession(SessionStore& store) {
    SessionInfo info;
    info.simulated = true;
    auto writer = store.BeginSession(info, {.group_frames = 2});
    if (!Ok("new session", writer.status())) return;
    for (int i = 0; i < 3; ++i) Ok("new frame", AppendFrame(*writer, i));
    Ok("new session's end", writer->Finish(SessionStatus::kComplete));
    const auto row = store.FindSession("latest");
    if (!Ok("new session", row.status())) return;
    Expect(row->info.id == writer->info().id, "the new session is not the latest one");
    CheckFrames(store, *row);
  }

  std::filesystem::path folder_;
  const Promise& promise_;
  CheckCounts& counts_;
  std::vector<std::string> broken_;
};

}  // namespace

std::vector<std::string> CheckStore(const std::filesystem::path& folder, const Promise& promise, CheckCounts& counts) {
  return Checker(folder, promise, counts).Run();
}

}  // namespace stratalux::db::crash
