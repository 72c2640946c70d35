// SPDX-License-Identifier: Apache-2.0
#include "tests/db/mutants/judge.h"

#include <algorithm>

#include "db/apps/session_views.h"
#include "db/base/own_hash.h"
#include "db/care/reindex.h"
#include "db/care/verify.h"
#include "db/catalogue/artifact_record.h"
#include "db/catalogue/fit_reader.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/named_query.h"
#include "db/catalogue/session_index.h"
#include "db/interchange/export.h"
#include "db/transfer/backup.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr const char* kRefused = "refused ";

// Columns that no file tells and no hash covers: the order of consents is the index's own, the first visit of a visitor
// may have been forgotten since.
bool IsLeftOut(const std::string& table, const std::string& column) {
  return (table == "consents" && column == "number") || table == "ledger_heads" ||
         (table == "visitors" && column == "created_wall_ns");
}

Status AddRows(Connection& connection, Picture& picture) {
  SLX_ASSIGN_OR_RETURN(
      auto tables,
      connection.Prepare("SELECT m.name, c.name FROM sqlite_master m, pragma_table_info("
                         "m.name) c WHERE m.type = 'table' AND m.name NOT LIKE 'sqlite_%'"
                         " AND m.name NOT IN ('jobs', 'job_fence', 'job_counts', 'access_log') ORDER BY 1, c.cid"));
  std::map<std::string, std::string> columns;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, tables.Step());
    if (!more) break;
    const std::string table = tables.Text(0), column = tables.Text(1);
    if (IsLeftOut(table, column)) continue;
    std::string& list = columns[table];
    list += (list.empty() ? "" : " || ' ' || ") + ("quote(\"" + column + "\")");
  }
  for (const auto& [table, list] : columns) {
    SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT " + list + " FROM \"" + table + "\""));
    while (true) {
      SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
      if (!more) break;
      picture.push_back(table + " " + select.Text(0));
    }
  }
  return Status::Ok();
}

std::string Refusal(const std::string& what, const Status& status) {
  return kRefused + what + ": " + std::to_string(status.exit_code());
}

// Files that rows and segments do not show: fits with their maps, the truth's calibration.
void AddFiles(const SessionStore& store, const std::string& id, Picture& picture) {
  std::error_code error;
  for (const auto& entry : fs::recursive_directory_iterator(store.SessionFolder(id), error)) {
    const std::string name = entry.path().lexically_relative(store.folder());
    if (!entry.is_regular_file(error)) continue;
    if (name.find("/fits/") != std::string::npos || name.ends_with("truth_calibration.json"))
      picture.push_back(name + " " + HashHex(ReadBytes(entry.path())));
  }
}

std::vector<std::string> NamesIn(const fs::path& folder, const char* record) {
  auto names = NamesOfFiles(folder, record);
  return names.ok() ? *std::move(names) : std::vector<std::string>();
}

// What an encrypted session's artifacts and fits hold, as whoever has the key reads it.
void AddSealed(const SessionStore& store, const std::string& id, Picture& picture) {
  auto seal = FindSeal(store, id);
  if (!seal.ok()) return picture.push_back(Refusal(id + " seal", seal.status()));
  if (!seal->active()) return;
  const fs::path opened = store.folder().string() + "-opened";
  const auto add = [&](const fs::path& file, const Result<fs::path>& plain) {
    const std::string name = file.lexically_relative(store.folder()).string() + " opened";
    picture.push_back(plain.ok() ? name + " " + HashHex(ReadBytes(*plain)) : Refusal(name, plain.status()));
  };
  std::error_code error;
  for (const auto& artifact : fs::directory_iterator(store.SessionFolder(id) / kArtifactsFolder, error)) {
    for (const std::string& name : NamesIn(artifact.path(), kArtifactRecordFile)) {
      const std::string place = PlaceOfArtifact(artifact.path().filename(), name);
      const Status status = seal->Open(artifact.path() / name, {place}, opened);
      add(artifact.path() / name, status.ok() ? Result<fs::path>(opened) : status);
    }
  }
  for (const auto& fit : fs::directory_iterator(store.SessionFolder(id) / "fits", error)) {
    auto reader = FitReader::Open(fit.path(), id, *seal);
    for (const std::string& name : NamesIn(fit.path(), kFitRecordFile)) {
      const auto file = reader.ok() ? reader->Read(name) : reader.status();
      add(fit.path() / name, file.ok() ? Result<fs::path>(file->path) : file.status());
    }
  }
  fs::remove(opened, error);
}

void AddFrames(const SessionStore& store, const std::string& id, Picture& picture) {
  const auto frames = store.ListFrames(id);
  if (!frames.ok()) return picture.push_back(Refusal(id, frames.status()));
  for (const FrameRow& frame : *frames) {
    const std::string name = id + " frame " + std::to_string(frame.id);
    const auto image = store.ReadFrame(id, frame);
    if (!image.ok()) {
      picture.push_back(Refusal(name, image.status()));
      continue;
    }
    const auto samples = std::as_const(*image).pixels();
    picture.push_back(
        name + " " +
        HashHex(std::span(reinterpret_cast<const uint8_t*>(samples.data()), samples.size() * sizeof(uint16_t))));
  }
}

// What people look at; only that it comes to an end.
void Look(const fs::path& folder, const fs::path& scratch) {
  Logger logger(LogLevel::kError);
  const auto store = SessionStore::Open(folder, AccessMode::kReadOnly);
  if (!store.ok()) return;
  const auto sessions = store->ListSessions();
  for (size_t i = 0; sessions.ok() && i < sessions->size(); ++i) {
    const std::string& id = (*sessions)[i].info.id;
    const auto row = store->FindSession(id);
    if (!row.ok()) continue;
    if (const auto details = LoadDetails(*store, id); details.ok())
      (void)(DetailsAsText(*details) + DetailsAsJson(*details)).size();
    if (const auto frames = store->ListFrames(id); frames.ok())
      (void)(FramesAsText(*frames) + FramesAsJson(*frames)).size();
    ExportOptions options;
    options.out = scratch / ("export-" + std::to_string(i));
    (void)ExportSession(*store, *row, options, logger).ok();
  }
  if (auto index = ReadOnlyIndex::Open(folder); index.ok())
    for (const NamedQuery& query : NamedQueries())
      (void)RunQuery(*index, query, {{"now_ns", Cell(int64_t{20'000})}}, {std::chrono::milliseconds(2'000)}).ok();
  (void)Backup(folder, {scratch / "backup", {}, ScrubShare::kAll}, logger).ok();
}

std::map<std::string, std::string> Segments(const fs::path& folder) {
  std::map<std::string, std::string> segments;
  std::error_code error;
  for (const auto& entry : fs::recursive_directory_iterator(folder / "sessions", error)) {
    if (!entry.is_regular_file() || entry.path().extension() != ".seg") continue;
    const auto bytes = ReadBytes(entry.path());
    segments[entry.path().lexically_relative(folder)] = {bytes.begin(), bytes.end()};
  }
  return segments;
}

// Of a session that was being written, what its recovery must leave alone.
std::string Kept(const SampleStore& sample, const std::string& name, const std::string& bytes) {
  const auto found = sample.acknowledged.find(name);
  return found == sample.acknowledged.end() ? bytes : bytes.substr(0, found->second);
}

// Frames whose key is gone are refused, and that is all that is different.
bool OnlyRefuses(const Picture& before, const Picture& after) {
  std::vector<std::string> come;
  std::set_difference(after.begin(), after.end(), before.begin(), before.end(), std::back_inserter(come));
  return before.size() == after.size() &&
         std::all_of(come.begin(), come.end(), [](const auto& line) { return line.starts_with(kRefused); });
}

bool HasRefusal(const Picture& picture) {
  return std::any_of(picture.begin(), picture.end(), [](const auto& line) { return line.starts_with(kRefused); });
}

}  // namespace

std::vector<std::string> Complaints(const SampleStore& sample, const fs::path& folder) {
  const auto store = SessionStore::Open(folder, AccessMode::kReadOnly);
  if (!store.ok()) return {store.status().message()};
  VerifyOptions options{VerifyDepth::kDeep};
  options.signed_by = sample.signed_by;
  std::vector<std::string> all;
  const auto add = [&all](const Result<VerifyReport>& report) {
    if (!report.ok()) return all.push_back(report.status().message());
    all.insert(all.end(), report->problems.begin(), report->problems.end());
  };
  add(VerifyStore(*store, options));
  const auto sessions = store->ListSessions();
  if (!sessions.ok()) all.push_back(sessions.status().message());
  for (size_t i = 0; sessions.ok() && i < sessions->size(); ++i) {
    const auto row = store->FindSession((*sessions)[i].info.id);
    if (row.ok())
      add(VerifySession(*store, *row, options));
    else
      all.push_back(row.status().message());
  }
  return all;
}

std::string FirstDifference(const Picture& before, const Picture& after) {
  std::vector<std::string> gone, come;
  std::set_difference(before.begin(), before.end(), after.begin(), after.end(), std::back_inserter(gone));
  std::set_difference(after.begin(), after.end(), before.begin(), before.end(), std::back_inserter(come));
  return "was: " + (gone.empty() ? std::string("-") : gone[0].substr(0, 500)) +
         "\n    is: " + (come.empty() ? std::string("-") : come[0].substr(0, 500));
}

const char* ToString(Verdict verdict) {
  const char* names[] = {"found", "harmless", "rightly taken", "SILENTLY ACCEPTED", "LAUNDERED", "FRAMES LOST"};
  return names[static_cast<int>(verdict)];
}

Picture PictureOf(const fs::path& folder) {
  Picture picture;
  auto index = SessionIndex::Open(folder, AccessMode::kReadOnly);
  if (!index.ok()) return {Refusal("index", index.status())};
  if (const Status rows = AddRows(index->connection(), picture); !rows.ok()) picture.push_back(Refusal("rows", rows));
  const auto store = SessionStore::Open(folder, AccessMode::kReadOnly);
  const auto sessions = store.ok() ? store->ListSessions() : store.status();
  if (!sessions.ok()) picture.push_back(Refusal("sessions", sessions.status()));
  for (size_t i = 0; sessions.ok() && i < sessions->size(); ++i) {
    AddFrames(*store, (*sessions)[i].info.id, picture);
    AddFiles(*store, (*sessions)[i].info.id, picture);
    AddSealed(*store, (*sessions)[i].info.id, picture);
  }
  std::sort(picture.begin(), picture.end());
  return picture;
}

Expected ExpectedOf(const SampleStore& sample, const fs::path& scratch) {
  Logger logger(LogLevel::kError);
  fs::copy(sample.folder, scratch, fs::copy_options::recursive);
  if (sample.road != Road::kOwn) {
    Expected expected;
    expected.arrival = Arrive(sample, scratch, scratch.string() + "-there");
    EXPECT_TRUE(expected.arrival.status.ok()) << expected.arrival.status.message();
    fs::remove_all(scratch);
    fs::remove_all(scratch.string() + "-there");
    return expected;
  }
  Expected expected{PictureOf(scratch), {}, {}};
  const auto done = Reindex(scratch, logger);
  EXPECT_TRUE(done.ok()) << done.status().message();
  expected.rebuilt = PictureOf(scratch);
  fs::remove_all(scratch);
  return expected;
}

Verdict Judge(const SampleStore& sample, const Expected& expected, const Mutant& mutant, const fs::path& folder,
              std::string& why) {
  if (sample.road != Road::kOwn) return JudgeArrival(sample, expected, mutant, folder, why);
  const auto segments = Segments(folder);
  const auto complaints = Complaints(sample, folder);
  Look(folder, folder.string() + "-scratch");
  const Picture picture = PictureOf(folder);
  Verdict verdict = Verdict::kFound;
  if (!complaints.empty()) why = complaints[0];
  if (complaints.empty()) {
    // Only a signature tells a forgery in which nothing disagrees; a cipher tells one of frames.
    const bool tellable = !mutant.consistent || sample.signed_by.has_value();
    verdict = picture == expected.as_it_is ? Verdict::kHarmless : tellable ? Verdict::kSilent : Verdict::kRightlyTaken;
    if (mutant.file.starts_with("keys.sqlite") && OnlyRefuses(expected.as_it_is, picture)) verdict = Verdict::kFound;
    if (IsWrong(verdict)) why = "verify --deep says nothing\n   " + FirstDifference(expected.as_it_is, picture);
  }
  if (IsWrong(verdict)) return verdict;
  Logger logger(LogLevel::kError);
  const auto reindexed = Reindex(folder, logger);
  for (const auto& [name, bytes] : Segments(folder))
    if (const auto before = segments.find(name);
        before != segments.end() && Kept(sample, name, before->second) != Kept(sample, name, bytes)) {
      why = "reindex changed " + name;
      return Verdict::kFramesLost;
    }
  for (const auto& [name, bytes] : segments)
    if (!fs::exists(folder / name)) {
      why = "reindex removed " + name;
      return Verdict::kFramesLost;
    }
  const bool said = !reindexed.ok() || !reindexed->problems.empty() || !reindexed->notes.empty();
  if (!mutant.leaves_hash || said) return verdict;
  const Picture rebuilt = PictureOf(folder);
  if (rebuilt == expected.rebuilt || rebuilt == expected.as_it_is || HasRefusal(rebuilt)) return verdict;
  if (!Complaints(sample, folder).empty()) return verdict;
  why = "reindex says nothing, and verify after it neither\n   " + FirstDifference(expected.rebuilt, rebuilt);
  return Verdict::kLaundered;
}

}  // namespace stratalux::db
