// SPDX-License-Identifier: Apache-2.0
#include <map>
#include <set>
#include <vector>

#include "db/base/durable_file.h"
#include "db/base/paths.h"
#include "db/base/write_lock.h"
#include "db/care/incoming.h"
#include "db/care/index_swap.h"
#include "db/catalogue/session_index.h"
#include "db/privacy/access_log.h"
#include "db/transfer/adopt.h"
#include "db/transfer/backup.h"
#include "db/transfer/backup_folder.h"
#include "db/transfer/file_copy.h"
#include "db/transfer/foreign_ledger.h"
#include "db/transfer/restored_index.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
constexpr const char* kUnfinished = "restore.unfinished";

// session id -> paths within the backup.
std::map<std::string, std::vector<std::string>> BySession(const FileList& list) {
  std::map<std::string, std::vector<std::string>> sessions;
  for (const auto& [path, file] : list.files)
    if (const std::string id = SessionOfPath(path); !id.empty()) sessions[id].push_back(path);
  return sessions;
}

// A store, a backup, or a folder of chains.
enum class LedgerPlace { kNone, kStore, kChains };
LedgerPlace PlaceOfLedger(const fs::path& folder) {
  std::error_code error;
  for (const char* name : {"ledger", "deletions", "index.sqlite"})
    if (fs::exists(folder / name, error)) return LedgerPlace::kStore;
  for (const auto& entry : fs::directory_iterator(folder, error))
    if (entry.path().extension() == ".jsonl") return LedgerPlace::kChains;
  return LedgerPlace::kNone;
}

Status CheckLedger(const fs::path& from, const RestoreOptions& options) {
  if (options.ledger == kNoLedger) return Status::Ok();
  if (options.ledger.empty() && options.into == RestoreInto::kMerge) return Status::Ok();  // the store has its own
  if (options.ledger.empty())
    return Status::Usage(
        "a restore into a new store needs the newest ledger, so that nobody comes back who was forgotten after the "
        "backup"
        " was made: --ledger PATH (the old store, its ledger folder, another store that pulled from it, or a newer"
        " backup), or --ledger none if none is left, which is logged");
  if (LiesIn(options.ledger, from))
    return Status::Usage("--ledger " + options.ledger +
                         " is the backup being restored; name a newer ledger, or none if there is none");
  if (PlaceOfLedger(options.ledger) == LedgerPlace::kNone)
    return Status::Usage("--ledger " + options.ledger + ": neither a store, nor a backup, nor a ledger folder");
  return Status::Ok();
}

// Leaves alone what is no interrupted restore: one that was cut before its mark was whole left the lock and the mark's
// new version at most.
Status CheckEmpty(const fs::path& store) {
  std::error_code error;
  if (fs::exists(store / kUnfinished, error)) return Status::Ok();
  for (const auto& entry : fs::directory_iterator(store, error)) {
    const std::string name = entry.path().filename().string();
    if (name != "incoming.lock" && name != std::string(kUnfinished) + ".new")
      return Status::Usage(store.string() + " is not empty; choose a new folder, or --merge to add what it lacks");
  }
  return Status::Ok();
}

// The mark is durable before anything else is there.
Status BeginStore(const fs::path& store) {
  SLX_RETURN_IF_ERROR(CheckEmpty(store));  // another restore may have ended here before the lock was ours
  SLX_RETURN_IF_ERROR(ReplaceFile(store / kUnfinished, "a restore is running, or was interrupted\n"));
  return MakeFolder(store / "sessions");
}

class Restorer {
 public:
  Restorer(fs::path from, fs::path store, const FileList& list, RestoreReport& report)
      : from_(std::move(from)), store_(std::move(store)), list_(list), report_(report) {}

  Status TakeLedgers(const RestoreOptions& options);
  Status TakeSessions(RestoreInto into, Logger& logger);
  Status SwapIn(const fs::path& fresh);
  Status PlaceIndex(Logger& logger);
  Status Bind(const RestoreOptions& options);

 private:
  void AddProblems(const std::string& where, const Result<LedgerMerge>& merge);
  Status Copy(const std::string& path, const fs::path& to);
  Status Fetch(const std::string& id, const std::vector<std::string>& paths);
  Status TakeNew(const std::string& id, const std::vector<std::string>& paths);
  Status TakeMerged(const std::string& id, const std::vector<std::string>& paths);
  Status WipeForgotten(const Ledger& ledger);

  const fs::path from_, store_;
  const FileList& list_;
  RestoreReport& report_;
};

void Restorer::AddProblems(const std::string& where, const Result<LedgerMerge>& merge) {
  if (!merge.ok()) return;
  for (const std::string& problem : merge->problems) report_.problems.push_back(where + ": " + problem);
}

// Before any session: what they forget is not even copied. The newest first: of two copies of a chain that differ, the
// first is kept as the chain and has the last word.
Status Restorer::TakeLedgers(const RestoreOptions& options) {
  if (!options.ledger.empty() && options.ledger != kNoLedger) {
    const auto newest = PlaceOfLedger(options.ledger) == LedgerPlace::kChains ? MergeLedger(store_, options.ledger)
                                                                              : AdoptLedger(store_, options.ledger);
    AddProblems("--ledger", newest);
    SLX_RETURN_IF_ERROR(newest.status().WithContext("--ledger " + options.ledger));
  }
  const auto own = AdoptLedger(store_, from_);
  AddProblems("ledger of the backup", own);
  return own.status();
}

// A file that is there with the right hash (of an interrupted restore) is not copied again.
Status Restorer::Copy(const std::string& path, const fs::path& to) {
  const ListedFile& file = list_.files.at(path);
  std::error_code error;
  if (fs::exists(to, error) && static_cast<int64_t>(fs::file_size(to, error)) == file.bytes) {
    const auto hash = HashFile(to);
    if (hash.ok() && *hash == file.hash) return Status::Ok();
  }
  auto copied = CopyFileHashed(from_ / path, to, file.hash);
  // Of a backup that was broken off behind its list.
  if (const fs::path waiting = WaitingFile(from_ / path); !copied.ok() && fs::exists(waiting, error))
    copied = CopyFileHashed(waiting, to, file.hash);
  SLX_RETURN_IF_ERROR(copied.status());
  ++report_.files;
  report_.bytes += file.bytes;
  return Status::Ok();
}

// Into STORE/incoming/<id>, verified as a session.
Status Restorer::Fetch(const std::string& id, const std::vector<std::string>& paths) {
  const std::string prefix = "sessions/" + id + "/";
  for (const std::string& path : paths)
    SLX_RETURN_IF_ERROR(Copy(path, IncomingFolder(store_, id) / path.substr(prefix.size())));
  return CheckFolder(IncomingFolder(store_, id)).status();
}

Status Restorer::TakeNew(const std::string& id, const std::vector<std::string>& paths) {
  const fs::path target = store_ / "sessions" / id;
  std::error_code error;
  if (fs::exists(target, error)) return Status::Ok();  // moved by an interrupted restore
  SLX_RETURN_IF_ERROR(Fetch(id, paths));
  SLX_RETURN_IF_ERROR(SyncTree(IncomingFolder(store_, id)));
  fs::rename(IncomingFolder(store_, id), target, error);
  return error ? Status::Failed("cannot move to " + target.string() + ": " + error.message()) : Status::Ok();
}

Status Restorer::TakeMerged(const std::string& id, const std::vector<std::string>& paths) {
  std::error_code error;
  if (fs::exists(store_ / "sessions" / id, error)) return ListAdopted(store_, id, "backup " + from_.string());
  SLX_RETURN_IF_ERROR(Fetch(id, paths));
  fs::remove(IncomingFolder(store_, id) / "place.json", error);  // its place in another store
  return AdoptFolder(store_, IncomingFolder(store_, id), "backup " + from_.string());
}

// Moved by an interrupted run, whose ledger did not forget them yet.
Status Restorer::WipeForgotten(const Ledger& ledger) {
  std::error_code error;
  std::vector<fs::path> gone;
  for (const auto& entry : fs::directory_iterator(store_ / "sessions", error))
    if (ledger.IsForgotten(entry.path().filename().string()) && !entry.is_symlink(error)) gone.push_back(entry.path());
  for (const fs::path& folder : gone) SLX_RETURN_IF_ERROR(WipeFolder(folder));
  return Status::Ok();
}

Status Restorer::TakeSessions(RestoreInto into, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store_));
  if (into == RestoreInto::kNewStore) SLX_RETURN_IF_ERROR(WipeForgotten(ledger));
  std::set<std::string> here;
  if (into == RestoreInto::kMerge) {
    SLX_ASSIGN_OR_RETURN(here, ListedSessions(store_));
  }
  const auto sessions = BySession(list_);
  Progress progress(logger, "restore", static_cast<int64_t>(sessions.size()));
  for (const auto& [id, paths] : sessions) {
    progress.Advance();
    if (ledger.IsForgotten(id)) {
      ++report_.forgotten;
      SLX_RETURN_IF_ERROR(WipeIncoming(store_, {id}).status());
      continue;
    }
    if (here.contains(id)) {
      ++report_.present;
      continue;
    }
    const Status taken = into == RestoreInto::kMerge ? TakeMerged(id, paths) : TakeNew(id, paths);
    if (IsTroubleOfAll(taken)) return taken.WithContext("session " + id);
    if (!taken.ok()) {
      report_.problems.push_back("session " + id + " was not restored: " + taken.message());
      SLX_RETURN_IF_ERROR(WipeIncoming(store_, {id}).status());
    } else {
      ++report_.sessions;
    }
  }
  return SyncFolder(store_ / "sessions");
}

// A run that was broken off may have placed one already, which programs have open, or whose log they left.
Status Restorer::SwapIn(const fs::path& fresh) {
  SLX_ASSIGN_OR_RETURN(auto held, ReleaseIndex(store_));
  const auto kept = SwapIndex(store_, fresh);
  held.reset();
  if (!kept.ok()) {
    (void)ResumeIndex(store_).ok();  // a damaged one cannot
    return kept.status();
  }
  // A newer ledger may forget whom it lists.
  std::error_code error;
  std::vector<fs::path> old;  // of one without an index the log alone, under the name that it would have
  for (const auto& entry : fs::directory_iterator(store_, error)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with(kKeptIndex)) old.push_back(entry.path());
  }
  if (error) return Status::Failed("cannot list " + store_.string() + ": " + error.message());
  for (const fs::path& file : old) SLX_RETURN_IF_ERROR(WipeFile(file));
  return Status::Ok();
}

Status Restorer::PlaceIndex(Logger& logger) {
  const fs::path work = store_ / "restore.index";
  std::error_code error;
  fs::remove_all(work, error);
  if (error) return Status::Failed("cannot remove " + work.string() + ": " + error.message());
  Status copied = list_.files.contains("index.sqlite") ? Copy("index.sqlite", work / "index.sqlite")
                                                       : Status::Integrity("the backup lists no index.sqlite");
  if (IsTroubleOfAll(copied)) return copied;
  Status placed;
  if (copied.ok()) {
    SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store_));  // what is captured meanwhile would not be listed
    copied = PrepareIndex(store_, work, "backup " + from_.string(), report_);
    if (copied.ok()) placed = SwapIn(work / "index.sqlite");
  }
  if (!copied.ok()) placed = RebuildIndex(store_, copied, logger, report_);  // takes the lock itself
  fs::remove_all(work, error);
  return placed;
}

// What the ledgers say comes to hold in the index, and that this store was restored stays known.
Status Restorer::Bind(const RestoreOptions& options) {
  SLX_ASSIGN_OR_RETURN(report_.withdrawals, ApplyWithdrawals(store_));
  SLX_ASSIGN_OR_RETURN(const auto forgotten, ForgottenButHere(store_));
  for (const std::string& id : forgotten)
    report_.problems.push_back("session " + id + " was forgotten elsewhere, but is here: `stratalux-db forget " + id +
                               "`");
  const std::string ledger = options.ledger.empty() ? "its own" : options.ledger;
  SLX_RETURN_IF_ERROR(LogAccess(store_, "restore", "", "backup " + from_.string() + ", ledger: " + ledger));
  if (options.ledger != kNoLedger) return Status::Ok();
  report_.notes.push_back(
      "restored without a newer ledger: whoever was forgotten after the backup was made may have returned");
  LedgerEntry note;
  note.kind = LedgerKind::kNote;
  note.at = WallNow();
  note.detail_json = R"({"restored": "without a newer ledger"})";
  return AppendToLedger(store_, note);
}

}  // namespace

Result<RestoreReport> Restore(const fs::path& from, const fs::path& store, const RestoreOptions& options,
                              Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const FileList list, ReadFileList(from));
  SLX_RETURN_IF_ERROR(CheckLedger(from, options));
  RestoreReport report;
  if (!list.intact)
    report.problems.push_back(
        (from / "backup.json").string() +
        " does not match its own hash: what it still lists is restored, but files may be missing");
  Restorer restorer(from, store, list, report);
  const bool merge = options.into == RestoreInto::kMerge;
  if (merge) {
    SLX_RETURN_IF_ERROR(SessionIndex::Open(store, AccessMode::kReadWrite).status());
  } else {
    SLX_RETURN_IF_ERROR(CheckEmpty(store));
    SLX_RETURN_IF_ERROR(MakeFolder(store));
  }
  SLX_ASSIGN_OR_RETURN(const auto lock, IncomingLock::Take(store));
  if (!merge) SLX_RETURN_IF_ERROR(BeginStore(store));
  SLX_RETURN_IF_ERROR(restorer.TakeLedgers(options));
  SLX_RETURN_IF_ERROR(restorer.TakeSessions(options.into, logger));
  if (!merge) SLX_RETURN_IF_ERROR(restorer.PlaceIndex(logger));
  SLX_RETURN_IF_ERROR(restorer.Bind(options));
  std::error_code error;
  if (!merge) fs::remove_all(store / "incoming", error);
  // Durable, too: a restore that came back with the power would place the backup's index over what was captured since.
  if (!merge && fs::remove(store / kUnfinished, error)) SLX_RETURN_IF_ERROR(SyncFolder(store));
  return report;
}

}  // namespace stratalux::db
