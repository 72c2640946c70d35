// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/backup.h"

#include <cerrno>
#include <cstring>
#include <set>

#include <fcntl.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/base/file_lock.h"
#include "db/base/paths.h"
#include "db/base/private_leftover.h"
#include "db/catalogue/session_index.h"
#include "db/ledger/ledger.h"
#include "db/ledger/old_tombstones.h"
#include "db/transfer/backup_folder.h"
#include "db/transfer/restored_index.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
constexpr const char* kLockName = "backup.lock";

// What a backup that was killed left of a copy, which may be one of all keys. kUsage for what is not ours.
Status WipePart(const fs::path& part) {
  SLX_ASSIGN_OR_RETURN(const auto left, FindPrivateLeftover(part));
  if (left == PrivateLeftover::kNone) return Status::Ok();
  if (left == PrivateLeftover::kForeign)
    return Status::Usage(part.string() + " was not left by a backup of this account; move it away");
  return WipeFile(part);
}

// One transaction's view of the whole database, in a file of its own; nothing of it stays where that fails.
Status Snapshot(const fs::path& database, const fs::path& to) {
  const fs::path part = to.string() + ".part";
  SLX_RETURN_IF_ERROR(WipePart(part));
  // Made by us and not by SQLite, so that a copy of all keys never has any other mode.
  const UniqueFd made(open(part.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0600));
  if (made.get() < 0) return Status::Failed("cannot create " + part.string() + ": " + std::strerror(errno));
  const auto copy = [&]() -> Status {
    SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(database, Connection::Mode::kReadOnly));
    SLX_RETURN_IF_ERROR(connection.CopyInto(part));
    return KeepFile(part, to);
  };
  const Status copied = copy();
  if (!copied.ok() && !WipeFile(part).ok()) unlink(part.c_str());
  return copied;
}

// The store or backup that a file would lie in; empty where there is none.
fs::path DataAround(const fs::path& file) {
  std::error_code error;
  for (fs::path folder = fs::weakly_canonical(fs::absolute(file, error), error).parent_path();;
       folder = folder.parent_path()) {
    for (const char* name : {"backup.json", kBackupJournal, "index.sqlite"})
      if (fs::exists(folder / name, error)) return folder;
    // A store whose index is lost.
    if (fs::is_directory(folder / "sessions", error) && fs::is_directory(folder / "ledger", error)) return folder;
    if (!folder.has_relative_path()) return {};
  }
}

Status CopyKeys(const fs::path& store, const BackupOptions& options) {
  if (options.keys.empty()) return Status::Ok();
  std::error_code error;
  const fs::path data = LiesIn(options.keys, options.to) ? options.to : DataAround(options.keys);
  if (!data.empty())
    return Status::Usage("--keys " + options.keys.string() + " lies within " + data.string() +
                         ": keys beside the data protect nothing, and are not destroyed when somebody is forgotten;"
                         " choose another place");
  if (fs::exists(options.keys, error)) return Status::Usage(options.keys.string() + " already exists; remove it first");
  if (!fs::exists(store / "keys.sqlite", error))
    return Status::NotFound("the store has no keys.sqlite: none of its sessions is encrypted");
  return Snapshot(store / "keys.sqlite", options.keys);
}

Status CheckTarget(const fs::path& store, const fs::path& to) {
  std::error_code error;
  if (LiesIn(to, store)) return Status::Usage("--to " + to.string() + " lies within the store; choose another disk");
  if (fs::exists(to / "backup.json", error) || fs::exists(to / kBackupJournal, error)) return Status::Ok();
  // The first run's journal may have been about to get its name.
  for (const auto& entry : fs::directory_iterator(to, error))
    if (const std::string name = entry.path().filename().string();
        name != kLockName && !name.starts_with(kBackupJournal))
      return Status::Usage(to.string() + " is neither empty nor an earlier backup; choose a folder of its own");
  return Status::Ok();
}

// The steps of one backup.
class BackupRun {
 public:
  BackupRun(fs::path store, fs::path to, BackupReport& report, Logger& logger)
      : store_(std::move(store)), to_(std::move(to)), fresh_(to_ / "index.new"), report_(report), logger_(logger) {}
  Status Run(ScrubShare share);

 private:
  Status ReadIndex();
  static Result<bool> HoldsSegments(SessionIndex& index, const std::string& id, const BackupFolder& folder);
  Status CopySessions(BackupFolder& folder);
  Status KeepLost(BackupFolder& folder);
  Status CopyTombstones(BackupFolder& folder);
  Status DropForgotten(BackupFolder& folder);

  const fs::path store_, to_, fresh_;
  BackupReport& report_;
  Logger& logger_;
  std::vector<std::string> ids_;     // finished sessions, in the order of their numbers
  std::set<std::string> recording_;  // in this snapshot
  std::set<std::string> other_;      // of which the backup has none, or another copy than the snapshot lists
};

Status BackupRun::ReadIndex() {
  // What a killed run left, first: SQLite would roll its journal into the new snapshot.
  std::error_code error;
  fs::remove_all(fresh_, error);
  if (error) return Status::Failed("cannot remove " + fresh_.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(MakeFolder(fresh_));
  SLX_RETURN_IF_ERROR(Snapshot(store_ / "index.sqlite", fresh_ / "index.sqlite"));
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(fresh_, AccessMode::kReadWrite));
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT id, status FROM sessions ORDER BY number"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    if (select.Text(1) == "recording") {
      report_.left_out.push_back(select.Text(0));
      recording_.insert(select.Text(0));
    } else {
      ids_.push_back(select.Text(0));
    }
  }
}

// False where a transcode has replaced the segments that the rows speak of since the snapshot.
Result<bool> BackupRun::HoldsSegments(SessionIndex& index, const std::string& id, const BackupFolder& folder) {
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT DISTINCT segment FROM frames WHERE session ="
                                                               " (SELECT number FROM sessions WHERE id = ?1)"));
  select.Bind(1, id);
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return true;
    if (!folder.Holds("sessions/" + id + "/" + SegmentName(select.Integer(0)))) return false;
  }
}

Status BackupRun::CopySessions(BackupFolder& folder) {
  Progress progress(logger_, "backup", static_cast<int64_t>(ids_.size()));
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store_));
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(fresh_, AccessMode::kReadOnly));
  for (const std::string& id : ids_) {
    progress.Advance();
    if (ledger.IsForgotten(id)) continue;
    const Status copied = folder.CopySession(id);
    if (copied.code() == StatusCode::kFailed) return copied;
    if (copied.ok()) {
      ++report_.sessions;
      SLX_ASSIGN_OR_RETURN(const bool as_listed, HoldsSegments(index, id, folder));
      if (!as_listed) other_.insert(id);
      continue;
    }
    // A forgetting may have begun while it was copied.
    SLX_ASSIGN_OR_RETURN(const Ledger now, Ledger::Read(store_));
    if (now.IsForgotten(id)) continue;
    other_.insert(id);
    report_.problems.push_back(
        "session " + id + ": " + copied.message() +
        (folder.KeepSession(id) ? "; its last good copy stays in the backup" : "; the backup has no copy of it"));
  }
  return Status::Ok();
}

// Sessions of the earlier backup that the index no longer lists, though nobody forgot them.
Status BackupRun::KeepLost(BackupFolder& folder) {
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store_));
  const std::set<std::string> listed(ids_.begin(), ids_.end());
  for (const std::string& id : folder.EarlierSessions()) {
    if (listed.contains(id) || ledger.IsForgotten(id)) continue;
    folder.KeepSession(id);
    if (!recording_.contains(id))
      report_.problems.push_back("session " + id +
                                 " is no longer in the store, and nobody forgot it: its last good copy stays in the"
                                 " backup; `stratalux-db restore --merge` brings it back");
  }
  return Status::Ok();
}

// Chains only ever grow, in the backup too, and verify themselves. A store before the ledger has its certificates.
Status BackupRun::CopyTombstones(BackupFolder& folder) {
  const auto merged = MergeLedger(to_, store_ / "ledger");
  if (merged.status().code() == StatusCode::kNewerSchema) {
    report_.problems.push_back("ledger: " + merged.status().message());
  } else if (!merged.ok()) {
    return merged.status();
  }
  for (const std::string& problem : merged.ok() ? merged->problems : std::vector<std::string>())
    report_.problems.push_back("ledger: " + problem);
  SLX_ASSIGN_OR_RETURN(const auto tombstones, ReadOldTombstones(store_));
  for (const OldTombstone& old : tombstones)
    if (old.entry.kind == LedgerKind::kForgotten)
      SLX_RETURN_IF_ERROR(folder.CopyFile(old.file.lexically_relative(store_).string()));
  return Status::Ok();
}

// A session that was forgotten meanwhile leaves neither files nor rows, nor its visitor's pseudonym. Rows of a damaged
// one do not fit its last good copy, nor those of one that was transcoded meanwhile its new one: a restore lists these
// by their own files.
Status BackupRun::DropForgotten(BackupFolder& folder) {
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store_));
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(fresh_, AccessMode::kReadWrite));
  Connection& connection = index.connection();
  bool any_forgotten = false;
  {
    SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
    // First, while the rows say whose they were.
    SLX_ASSIGN_OR_RETURN(any_forgotten, ForgetRows(index, ledger));
    SLX_RETURN_IF_ERROR(connection.Execute("DELETE FROM sessions WHERE status = 'recording'"));
    SLX_ASSIGN_OR_RETURN(auto remove, connection.Prepare("DELETE FROM sessions WHERE id = ?1"));
    for (const std::string& id : other_) SLX_RETURN_IF_ERROR(remove.Bind(1, id).Run());
    SLX_RETURN_IF_ERROR(transaction.Commit());
  }
  for (const auto& [id, certificate] : ledger.forgotten()) folder.DropSession(id);
  if (any_forgotten) SLX_RETURN_IF_ERROR(connection.Execute("VACUUM"));
  return connection.Execute("PRAGMA journal_mode = DELETE");
}

Status BackupRun::Run(ScrubShare share) {
  SLX_ASSIGN_OR_RETURN(auto folder, BackupFolder::Open(store_, to_, report_));
  // The files it lists are there and final when it says so; hence the index first.
  SLX_RETURN_IF_ERROR(ReadIndex());
  SLX_RETURN_IF_ERROR(CopySessions(folder));
  SLX_RETURN_IF_ERROR(KeepLost(folder));
  SLX_RETURN_IF_ERROR(folder.Scrub(share));
  SLX_RETURN_IF_ERROR(CopyTombstones(folder));
  SLX_RETURN_IF_ERROR(DropForgotten(folder));
  SLX_RETURN_IF_ERROR(folder.PlaceFile(fresh_ / "index.sqlite", "index.sqlite"));
  std::error_code error;
  fs::remove_all(fresh_, error);
  return folder.Finish();
}

}  // namespace

Result<BackupReport> Backup(const fs::path& store, const BackupOptions& options, Logger& logger) {
  SLX_RETURN_IF_ERROR(SessionIndex::Open(store, AccessMode::kReadOnly).status());
  SLX_RETURN_IF_ERROR(CheckTarget(store, options.to));
  SLX_RETURN_IF_ERROR(MakeFolder(options.to));
  SLX_ASSIGN_OR_RETURN(const auto lock,
                       FileLock::TryTake(options.to / kLockName, "another backup to " + options.to.string() +
                                                                     " is running; try again when it has"
                                                                     " finished"));
  SLX_RETURN_IF_ERROR(CopyKeys(store, options));
  BackupReport report;
  const Status made = BackupRun(store, options.to, report, logger).Run(options.scrub);
  if (!made.ok())
    return made.WithContext("the backup was not finished; what was in " + options.to.string() +
                            " before stays valid, and the next run continues");
  return report;
}

}  // namespace stratalux::db
