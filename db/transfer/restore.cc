// SPDX-License-Identifier: Apache-2.0
#include <map>
#include <vector>

#include "db/base/durable_file.h"
#include "db/catalogue/session_index.h"
#include "db/ledger/tombstone.h"
#include "db/transfer/adopt.h"
#include "db/transfer/backup.h"
#include "db/transfer/file_copy.h"
#include "db/transfer/file_list.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

// session id -> paths within the backup.
std::map<std::string, std::vector<std::string>> BySession(const FileList& list) {
  std::map<std::string, std::vector<std::string>> sessions;
  for (const auto& [path, file] : list.files) {
    if (!path.starts_with("sessions/")) continue;
    const size_t slash = path.find('/', 9);
    if (slash != std::string::npos) sessions[path.substr(9, slash - 9)].push_back(path);
  }
  return sessions;
}

class Restorer {
 public:
  Restorer(const fs::path& from, const fs::path& store, const FileList& list, RestoreReport& report)
      : from_(from), store_(store), list_(list), report_(report) {}

  // A file that is there with the right hash (of an interrupted restore) is not copied again.
  Status Copy(const std::string& path, const fs::path& to) {
    const ListedFile& file = list_.files.at(path);
    std::error_code error;
    if (fs::exists(to, error) && static_cast<int64_t>(fs::file_size(to, error)) == file.bytes) {
      const auto hash = HashFile(to);
      if (hash.ok() && *hash == file.hash) return Status::Ok();
    }
    SLX_RETURN_IF_ERROR(CopyFileHashed(from_ / path, to, file.hash).status());
    ++report_.files;
    report_.bytes += file.bytes;
    return Status::Ok();
  }

  Status CopyTombstones() {
    for (const auto& [path, file] : list_.files)
      if (path.starts_with("deletions/")) SLX_RETURN_IF_ERROR(Copy(path, store_ / path));
    return Status::Ok();
  }

  [[nodiscard]] bool Forgotten(const std::string& id) const {
    return HasTombstone(from_, id) || HasTombstone(store_, id);
  }

  // Into STORE/incoming/<id>, verified as a session.
  Status Fetch(const std::string& id, const std::vector<std::string>& paths) {
    const std::string prefix = "sessions/" + id + "/";
    for (const std::string& path : paths) SLX_RETURN_IF_ERROR(Copy(path, Incoming(id) / path.substr(prefix.size())));
    return VerifyFolder(Incoming(id)).status();
  }

  [[nodiscard]] fs::path Incoming(const std::string& id) const { return store_ / "incoming" / id; }

 private:
  const fs::path& from_;
  const fs::path& store_;
  const FileList& list_;
  RestoreReport& report_;
};

Status CheckEmpty(const fs::path& store) {
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(store, error)) {
    const auto name = entry.path().filename();
    const bool interrupted = fs::exists(store / "restore.unfinished", error);
    if (!interrupted || name == "index.sqlite")
      return Status::Usage(store.string() + " is not empty; choose a new folder, or --merge to add what it lacks");
  }
  return Status::Ok();
}

// The backup's index without what tombstones of either side forbid.
Status PlaceIndex(Restorer& restorer, const fs::path& store) {
  const fs::path work = store / "incoming" / "index";
  SLX_RETURN_IF_ERROR(restorer.Copy("index.sqlite", work / "index.sqlite"));
  {
    SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(work, AccessMode::kReadWrite));
    SLX_ASSIGN_OR_RETURN(auto remove, index.connection().Prepare("DELETE FROM sessions WHERE id = ?1"));
    SLX_ASSIGN_OR_RETURN(const auto sessions, index.Sessions());
    for (const SessionSummary& row : sessions)
      if (restorer.Forgotten(row.info.id)) SLX_RETURN_IF_ERROR(remove.Bind(1, row.info.id).Run());
    SLX_RETURN_IF_ERROR(index.connection().Execute("PRAGMA journal_mode = WAL; PRAGMA wal_checkpoint(TRUNCATE)"));
  }
  SLX_RETURN_IF_ERROR(SyncTree(work));
  std::error_code error;
  fs::rename(work / "index.sqlite", store / "index.sqlite", error);
  if (error) return Status::Failed("cannot move the index into " + store.string() + ": " + error.message());
  return SyncFolder(store);
}

Status RestoreNew(Restorer& restorer, const FileList& list, const fs::path& store, Logger& logger,
                  RestoreReport& report) {
  SLX_RETURN_IF_ERROR(CheckEmpty(store));
  SLX_RETURN_IF_ERROR(MakeFolder(store / "sessions"));
  SLX_RETURN_IF_ERROR(ReplaceFile(store / "restore.unfinished", "a restore is running, or was interrupted\n"));
  SLX_RETURN_IF_ERROR(restorer.CopyTombstones());
  const auto sessions = BySession(list);
  Progress progress(logger, "restore", static_cast<int64_t>(sessions.size()));
  for (const auto& [id, paths] : sessions) {
    progress.Advance();
    if (restorer.Forgotten(id)) {
      ++report.forgotten;
      continue;
    }
    ++report.sessions;
    std::error_code error;
    const fs::path target = store / "sessions" / id;
    if (fs::exists(target, error)) continue;  // moved by an interrupted restore
    SLX_RETURN_IF_ERROR(restorer.Fetch(id, paths).WithContext("session " + id));
    fs::rename(restorer.Incoming(id), target, error);
    if (error) return Status::Failed("cannot move to " + target.string() + ": " + error.message());
  }
  SLX_RETURN_IF_ERROR(SyncFolder(store / "sessions"));
  SLX_RETURN_IF_ERROR(PlaceIndex(restorer, store));
  std::error_code error;
  fs::remove_all(store / "incoming", error);
  fs::remove(store / "restore.unfinished", error);
  return Status::Ok();
}

Status RestoreMerged(Restorer& restorer, const FileList& list, const fs::path& from, const fs::path& store,
                     Logger& logger, RestoreReport& report) {
  const auto sessions = BySession(list);
  Progress progress(logger, "restore", static_cast<int64_t>(sessions.size()));
  for (const auto& [id, paths] : sessions) {
    progress.Advance();
    SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
    std::error_code error;
    if (restorer.Forgotten(id)) {
      ++report.forgotten;
    } else if (index.NumberOf(id).ok()) {
      ++report.present;
    } else if (fs::exists(store / "sessions" / id, error)) {
      SLX_RETURN_IF_ERROR(ListAdopted(store, id, "backup " + from.string()));
      ++report.sessions;
    } else {
      SLX_RETURN_IF_ERROR(restorer.Fetch(id, paths).WithContext("session " + id));
      fs::remove(restorer.Incoming(id) / "place.json", error);  // its place in another store
      SLX_RETURN_IF_ERROR(AdoptFolder(store, restorer.Incoming(id), "backup " + from.string()));
      ++report.sessions;
    }
  }
  // A tombstone of a session that is here is for `forget` to bring about, not for a restore.
  for (const auto& [path, file] : list.files) {
    const std::string id = fs::path(path).stem().string();
    std::error_code error;
    if (path.starts_with("deletions/") && !fs::exists(store / "sessions" / id, error))
      SLX_RETURN_IF_ERROR(restorer.Copy(path, store / path));
  }
  return Status::Ok();
}

}  // namespace

Result<RestoreReport> Restore(const fs::path& from, const fs::path& store, RestoreInto into, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const FileList list, ReadFileList(from));
  if (!list.files.contains("index.sqlite"))
    return Status::Integrity((from / "backup.json").string() + " names no index.sqlite");
  RestoreReport report;
  Restorer restorer(from, store, list, report);
  if (into == RestoreInto::kMerge) {
    SLX_RETURN_IF_ERROR(SessionIndex::Open(store, AccessMode::kReadWrite).status());
    SLX_ASSIGN_OR_RETURN(const auto lock, IncomingLock::Take(store));
    SLX_RETURN_IF_ERROR(RestoreMerged(restorer, list, from, store, logger, report));
    return report;
  }
  SLX_RETURN_IF_ERROR(RestoreNew(restorer, list, store, logger, report));
  return report;
}

}  // namespace stratalux::db
