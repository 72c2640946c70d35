// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/merge.h"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <csignal>
#include <map>
#include <utility>

#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/base/file_lock.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/fit_reader.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/fit_store.h"
#include "db/privacy/access_log.h"
#include "fitter/batch/night_choice.h"
#include "fitter/batch/night_status.h"
#include "fitter/pipeline/artifact_store.h"
#include "fitter/pipeline/publish.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

constexpr const char* kAside = ".closed-";  // RESULTS.closed-<process>, while it is removed

// In `to`, with the files that are artifacts of the store as further names of those.
Status CopyFit(const fs::path& from, const fs::path& to, const fs::path& session_folder) {
  SLX_ASSIGN_OR_RETURN(const db::FitRow row, db::ReadFitRecord(from, session_folder.filename().string()));
  SLX_ASSIGN_OR_RETURN(const auto names, db::NamesOfFiles(from, db::kFitRecordFile));
  std::error_code error;
  const auto artifact_file = [&](const std::string& name) -> fs::path {
    for (const auto& [stage, folder] : row.artifacts)
      if (fs::path file = session_folder / db::kArtifactsFolder / folder / name; fs::exists(file, error)) return file;
    return {};
  };
  for (const std::string& name : names) {
    SLX_RETURN_IF_ERROR(db::MakeFolder((to / name).parent_path()));
    const fs::path file = artifact_file(name);
    if (!file.empty()) fs::create_hard_link(file, to / name, error);
    if (file.empty() || error) fs::copy_file(from / name, to / name, error);
    if (error) return Status::Failed("cannot copy " + (from / name).string() + ": " + error.message());
  }
  fs::copy_file(from / db::kFitRecordFile, to / db::kFitRecordFile, error);
  return error ? Status::Failed("cannot copy " + (from / db::kFitRecordFile).string() + ": " + error.message())
               : Status::Ok();
}

// What a shard's file is not as it should be is a problem of one visitor; the store's own troubles end the merge.
bool IsTroubleOfOne(const Status& status) {
  return status.code() == StatusCode::kIntegrity || status.code() == StatusCode::kNotFound ||
         status.code() == StatusCode::kNewerSchema || status.code() == StatusCode::kUsage;
}

class Merger {
 public:
  Merger(fs::path store, fs::path results, ShardPlan plan, NightLog log, db::SessionStore index, Logger& logger)
      : store_(std::move(store)),
        results_(std::move(results)),
        plan_(std::move(plan)),
        log_(std::move(log)),
        index_(std::move(index)),
        logger_(logger) {}
  Result<MergeOutcome> Run(MergeMode mode);

 private:
  Status ReadEarlier();
  Status ReadManifests();
  Status Begin();
  Status Merge(const PlannedVisit& visit);
  Status Drop(const PlannedVisit& visit, const std::string& reason);
  Status Take(const PlannedVisit& visit, const ShardVisit& said);
  Status Keep(const PlannedVisit& visit);
  Status Enter(const PlannedVisit& visit, const ShardVisit& said);
  Status Tell(const NightEvent& event);
  // A fault of RESULTS is a problem of one visitor.
  void NoteTrouble(const Status& of_results) {
    if (!of_results.ok()) outcome_.problems.push_back(of_results.message());
  }

  const fs::path store_, results_;
  const ShardPlan plan_;
  NightLog log_;
  db::SessionStore index_;
  Logger& logger_;
  NightStatus told_;                               // what the night's log says
  std::map<std::string, const NightVisit*> ends_;  // of those
  int nameless_ = 0;                               // dropped, of sessions that were forgotten since
  std::vector<ShardManifest> manifests_;
  MergeOutcome outcome_;
};

Status Merger::ReadEarlier() {
  SLX_ASSIGN_OR_RETURN(const NightRecord record, ReadNight(log_.folder()));
  told_ = StatusOf(record.events);
  for (const NightVisit& visit : told_.visits) ends_[visit.session] = &visit;
  nameless_ = static_cast<int>(std::count_if(record.events.begin(), record.events.end(), [](const NightEvent& event) {
    return event.kind == NightEventKind::kDropped && event.session.empty();
  }));
  return Status::Ok();
}

Status Merger::ReadManifests() {
  SLX_ASSIGN_OR_RETURN(const auto files, ManifestFiles(results_));
  for (const fs::path& file : files) {
    auto manifest = ReadManifest(file, plan_);
    if (manifest.ok()) {
      manifests_.push_back(std::move(*manifest));
      continue;
    }
    outcome_.problems.push_back(manifest.status().message());
    const StatusCode code = manifest.status().code();
    if (code == StatusCode::kFailed || code == StatusCode::kNotFound)
      outcome_.unread.push_back(outcome_.problems.back());
  }
  return Status::Ok();
}

Status Merger::Begin() {
  if (told_.began.ns != 0) return Status::Ok();
  SLX_RETURN_IF_ERROR(
      log_.Add({.kind = NightEventKind::kBegan, .at = plan_.made, .count = static_cast<int64_t>(plan_.visits.size())}));
  for (const NightEvent& event : plan_.left_out) SLX_RETURN_IF_ERROR(log_.Add(event));
  return Status::Ok();
}

// Once: merging again says nothing anew.
Status Merger::Tell(const NightEvent& event) {
  const auto end = ends_.find(event.session);
  if (end != ends_.end() && end->second->kind == event.kind && end->second->reason == event.reason) return Status::Ok();
  NightEvent started{.kind = NightEventKind::kStarted, .at = event.at, .session = event.session, .fit = event.fit};
  started.at.ns -= static_cast<int64_t>(1e9 * event.seconds);
  started.attempt = event.attempt;
  SLX_RETURN_IF_ERROR(log_.Add(started));
  return log_.Add(event);
}

// Of a forgotten session the log keeps that there was one.
Status Merger::Drop(const PlannedVisit& visit, const std::string& reason) {
  ++outcome_.dropped;
  NoteTrouble(RemoveResults(results_, visit.session));
  SLX_ASSIGN_OR_RETURN(const bool forgotten, db::IsForgotten(store_, visit.session));
  NightEvent event{.kind = NightEventKind::kDropped, .at = WallNow(), .session = visit.session, .reason = reason};
  if (!forgotten) return Tell(event);
  return nameless_-- > 0 ? Status::Ok() : log_.Add(event);
}

Status Merger::Enter(const PlannedVisit& visit, const ShardVisit& said) {
  const fs::path made = ResultsOf(results_, visit.session), session = index_.SessionFolder(visit.session);
  const MadeFolder fit{"fits/" + visit.fit, ""};
  if (said.made.empty() || said.made.back().place != fit.place)
    return Status::Integrity("session " + visit.session + ": its shard made no fit " + visit.fit);
  const Status checked = CheckRecords(made, said.made);
  if (checked.code() == StatusCode::kFailed) {
    outcome_.unread.push_back(checked.message());
    return Status::Integrity(checked.message());
  }
  SLX_RETURN_IF_ERROR(checked);
  SLX_ASSIGN_OR_RETURN(const db::FileSeal seal, db::FindSeal(index_, visit.session));
  SLX_ASSIGN_OR_RETURN(auto artifacts, ArtifactStore::Open(session, PlainFiles(seal), logger_));
  SLX_ASSIGN_OR_RETURN(const UniqueFd in_use, artifacts.Use());
  for (const MadeFolder& one : said.made)
    if (one.place != fit.place) SLX_RETURN_IF_ERROR(artifacts.Adopt(made / one.place));
  const std::string lock_name = LockOfFit(visit.fit);
  SLX_ASSIGN_OR_RETURN(const KeyLock lock, artifacts.Lock(lock_name, "enters this fit"));
  return artifacts.Beside(lock_name, [&](const fs::path& folder) -> Status {
    SLX_RETURN_IF_ERROR(CopyFit(made / fit.place, folder / visit.fit, session));
    return db::AdoptFit(store_, visit.session, folder / visit.fit).status();
  });
}

Status Merger::Take(const PlannedVisit& visit, const ShardVisit& said) {
  SLX_RETURN_IF_ERROR(Enter(visit, said));
  SLX_RETURN_IF_ERROR(db::LogAccess(store_, "fit", visit.session, "fit " + visit.fit));
  ++outcome_.entered;
  SLX_RETURN_IF_ERROR(Tell(said.end));
  NoteTrouble(MarkMerged(results_, visit.session));
  return Status::Ok();
}

// By an earlier merge, one that was cut off before it could say so, or by a night of this store meanwhile.
Status Merger::Keep(const PlannedVisit& visit) {
  ++outcome_.present;
  NightEvent end{.kind = NightEventKind::kDone, .at = WallNow(), .session = visit.session, .fit = visit.fit};
  for (const ShardManifest& manifest : manifests_)
    if (const ShardVisit* said = manifest.Find(visit.session); said != nullptr && said->end.kind == end.kind)
      end = said->end;
  SLX_RETURN_IF_ERROR(Tell(end));
  // Again, too: a shard that was run once more may have made something since.
  NoteTrouble(MarkMerged(results_, visit.session));
  return Status::Ok();
}

Status Merger::Merge(const PlannedVisit& visit) {
  const auto row = index_.FindSession(visit.session);
  if (row.ok()) {
    SLX_ASSIGN_OR_RETURN(const auto fits, index_.ListFits(visit.session));
    if (std::any_of(fits.begin(), fits.end(), [&](const db::FitRow& fit) { return fit.id == visit.fit; }))
      return Keep(visit);
  }
  const Status may = row.ok() ? MayStillBeFitted(store_, visit.session, row->info.visitor)
                              : db::RefuseForgotten(store_, visit.session);
  if (Forbids(may)) return Drop(visit, may.message());
  SLX_RETURN_IF_ERROR(may);
  if (!row.ok()) return row.status();
  const ShardVisit* ended = nullptr;
  for (const ShardManifest& manifest : manifests_) {
    const ShardVisit* said = manifest.Find(visit.session);
    if (said == nullptr) continue;
    if (said->end.kind != NightEventKind::kDone) {
      ended = said;
      continue;
    }
    const Status taken = Take(visit, *said);
    if (taken.ok() || !IsTroubleOfOne(taken)) return taken;
    outcome_.problems.push_back(taken.message());
  }
  if (ended == nullptr) {
    outcome_.missing.push_back(visit.session);
    return Status::Ok();
  }
  if (ended->end.kind == NightEventKind::kDropped)
    ++outcome_.dropped;
  else
    outcome_.failed.push_back(ended->end);
  return Tell(ended->end);
}

Result<MergeOutcome> Merger::Run(MergeMode mode) {
  outcome_.night = log_.folder().filename().string();
  SLX_RETURN_IF_ERROR(ReadEarlier());
  SLX_RETURN_IF_ERROR(Begin());
  SLX_RETURN_IF_ERROR(ReadManifests());
  Progress progress(logger_, "merge", static_cast<int64_t>(plan_.visits.size()));
  for (const PlannedVisit& visit : plan_.visits) {
    SLX_RETURN_IF_ERROR(Merge(visit));
    progress.Advance();
  }
  const bool stays = mode == MergeMode::kKeep || !outcome_.unread.empty();
  if ((stays && !outcome_.missing.empty()) || told_.ended) return outcome_;
  const WallNs now = WallNow();
  NightEvent ended{.kind = NightEventKind::kEnded,
                   .at = now,
                   .seconds = 1e-9 * static_cast<double>(now.ns - plan_.made.ns),
                   .count = outcome_.entered + outcome_.present};
  if (!outcome_.missing.empty())
    ended.reason = std::to_string(outcome_.missing.size()) + " visitors are missing; they wait for the next night";
  SLX_RETURN_IF_ERROR(log_.Add(ended));
  return outcome_;
}

fs::path WithoutSlash(const fs::path& path) { return path.has_filename() ? path : path.parent_path(); }

// Where a link leads, though it leads to nothing any more: what a killed close set aside lies beside that.
fs::path FolderOf(const fs::path& given) {
  constexpr int kMostLinks = 40;  // as Linux follows
  std::error_code error;
  fs::path at = fs::absolute(given, error);
  for (int i = 0; i < kMostLinks && fs::is_symlink(at, error); ++i)
    at = WithoutSlash(at.parent_path() / fs::read_symlink(at, error));
  const fs::path folder = fs::weakly_canonical(at, error);
  return error ? at : WithoutSlash(folder);
}

// What a merge that was killed while it removed RESULTS has left beside it: faces, under a name that nobody looks for.
void RemoveLeftAside(const fs::path& results, Logger& logger) {
  const std::string begin = results.filename().string() + kAside;
  std::error_code error;
  std::vector<fs::path> left;
  for (fs::directory_iterator at(results.parent_path(), error), end; !error && at != end; at.increment(error)) {
    const std::string name = at->path().filename().string();
    pid_t process = 0;
    if (!name.starts_with(begin)) continue;
    const char* const last = name.data() + name.size();
    const auto [read, problem] = std::from_chars(name.data() + begin.size(), last, process);
    if (problem != std::errc() || read != last || process <= 0) continue;
    // This process has set nothing aside yet: what has its number is of one before.
    if (process == getpid() || (kill(process, 0) != 0 && errno == ESRCH)) left.push_back(at->path());
  }
  for (const fs::path& folder : left) {
    fs::remove_all(folder, error);
    if (error) logger.Warning("cannot remove " + folder.string() + ": " + error.message());
  }
}

}  // namespace

Result<MergeOutcome> MergeShards(const fs::path& store, const fs::path& given, MergeMode mode, Logger& logger) {
  std::error_code error;
  // What is removed is the folder, and the link to it then.
  const fs::path link = WithoutSlash(given), results = FolderOf(link);
  if (mode == MergeMode::kClose) {
    RemoveLeftAside(results, logger);
    // A close that was killed behind the folder: the next plan is written where the link is.
    if (fs::is_symlink(link, error) && fs::is_directory(results.parent_path(), error) &&
        fs::symlink_status(results, error).type() == fs::file_type::not_found)
      fs::remove(link, error);
  }
  SLX_ASSIGN_OR_RETURN(ShardPlan plan, ReadPlan(results));
  SLX_ASSIGN_OR_RETURN(auto index, db::SessionStore::Open(store, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto lock, db::FileLock::TryTake(results / ".merge.lock",
                                                              "another merge of " + results.string() + " is running"));
  constexpr size_t kDigits = 8;
  SLX_ASSIGN_OR_RETURN(auto log, NightLog::Open(store, NightMoment(plan.made) + "-" + plan.id.substr(0, kDigits)));
  SLX_ASSIGN_OR_RETURN(MergeOutcome outcome,
                       Merger(store, results, std::move(plan), std::move(log), std::move(index), logger).Run(mode));
  if (mode == MergeMode::kKeep) return outcome;
  if (!outcome.unread.empty()) {
    for (const std::string& problem : outcome.problems) logger.Warning(problem);
    return Status::Failed(results.string() + " is kept: the part of it that could not be read may hold fits (" +
                          std::to_string(outcome.unread.size()) + " files, such as: " + outcome.unread.front() +
                          "). Merge again once it can be read; remove by hand what is lost for good");
  }
  // Aside first, where that can be: who looks for a plan or an ask meanwhile finds none, not half of them.
  fs::path aside = results;
  aside += kAside + std::to_string(getpid());
  fs::rename(results, aside, error);
  const fs::path old = error ? results : aside;
  fs::remove_all(old, error);
  if (error) return Status::Failed("cannot remove " + old.string() + ": " + error.message());
  if (fs::is_symlink(link, error)) fs::remove(link, error);
  return outcome;
}

}  // namespace stratalux::fit
