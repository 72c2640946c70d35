// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/backup.h"

#include <algorithm>
#include <set>

#include <sys/stat.h>

#include "db/base/durable_file.h"
#include "db/catalogue/session_index.h"
#include "db/ledger/tombstone.h"
#include "db/transfer/adopt.h"
#include "db/transfer/file_copy.h"
#include "db/transfer/file_list.h"
#include "shared/base/version.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

std::string Quoted(const fs::path& file) {
  std::string text = "'";
  for (char c : file.string()) text += c == '\'' ? std::string("''") : std::string(1, c);
  return text + "'";
}

bool LiesIn(const fs::path& file, const fs::path& folder) {
  std::error_code error;
  const fs::path inside = fs::weakly_canonical(file, error), outside = fs::weakly_canonical(folder, error);
  return std::mismatch(outside.begin(), outside.end(), inside.begin(), inside.end()).first == outside.end();
}

// One transaction's view of the whole database, in a file of its own.
Status Snapshot(const fs::path& database, const fs::path& to) {
  std::error_code error;
  const fs::path part = to.string() + ".part";
  fs::remove(part, error);
  SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(database, Connection::Mode::kReadOnly));
  SLX_RETURN_IF_ERROR(connection.Execute("VACUUM INTO " + Quoted(part)));
  if (chmod(part.c_str(), 0600) != 0) return Status::Failed("cannot protect " + part.string());
  fs::rename(part, to, error);
  if (error) return Status::Failed("cannot move " + part.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(SyncTree(to.parent_path().empty() ? fs::path(".") : to.parent_path()));
  return Status::Ok();
}

Status CopyKeys(const fs::path& store, const BackupOptions& options) {
  if (options.keys.empty()) return Status::Ok();
  std::error_code error;
  if (LiesIn(options.keys, options.to))
    return Status::Usage("--keys " + options.keys.string() +
                         " lies within the backup: keys beside the data protect nothing; choose another place");
  if (fs::exists(options.keys, error))
    return Status::Usage(options.keys.string() + " is there already; remove it first");
  if (!fs::exists(store / "keys.sqlite", error))
    return Status::NotFound("the store has no keys.sqlite: none of its sessions is encrypted");
  return Snapshot(store / "keys.sqlite", options.keys);
}

class Copier {
 public:
  Copier(fs::path store, fs::path to, BackupReport& report)
      : store_(std::move(store)), to_(std::move(to)), report_(report) {
    if (auto earlier = ReadFileList(to_); earlier.ok()) earlier_ = std::move(earlier).value();
  }

  [[nodiscard]] bool Unchanged(const fs::path& path) const {
    const auto known = earlier_.files.find(path.string());
    if (known == earlier_.files.end()) return false;
    std::error_code error;
    const auto time = ModifiedNs(store_ / path);
    return time.ok() && *time == known->second.source_mtime_ns &&
           static_cast<int64_t>(fs::file_size(store_ / path, error)) == known->second.bytes &&
           static_cast<int64_t>(fs::file_size(to_ / path, error)) == known->second.bytes;
  }

  Status Copy(const fs::path& path) {
    std::error_code error;
    if (Unchanged(path)) {
      list_.files[path.string()] = earlier_.files.at(path.string());
      ++report_.files_kept;
      return Status::Ok();
    }
    ListedFile file;
    SLX_ASSIGN_OR_RETURN(file.source_mtime_ns, ModifiedNs(store_ / path));
    SLX_ASSIGN_OR_RETURN(file.hash, CopyFileHashed(store_ / path, to_ / path, ""));
    file.bytes = static_cast<int64_t>(fs::file_size(to_ / path, error));
    list_.files[path.string()] = file;
    ++report_.files_copied;
    report_.bytes_copied += file.bytes;
    return Status::Ok();
  }

  // A file that was made in the backup itself.
  Status List(const fs::path& path) {
    ListedFile file;
    std::error_code error;
    SLX_ASSIGN_OR_RETURN(file.hash, HashFile(to_ / path));
    file.bytes = static_cast<int64_t>(fs::file_size(to_ / path, error));
    list_.files[path.string()] = file;
    return Status::Ok();
  }

  Status CopySession(const std::string& id) {
    const fs::path folder = fs::path("sessions") / id;
    std::vector<fs::path> files;
    std::error_code error;
    for (auto entry = fs::recursive_directory_iterator(store_ / folder, error);
         !error && entry != fs::recursive_directory_iterator(); entry.increment(error)) {
      if (entry->path().extension() == ".partial") {
        entry.disable_recursion_pending();  // a fit that is being made
      } else if (entry->is_regular_file(error)) {
        files.push_back(entry->path().lexically_relative(store_));
      }
    }
    if (error) return Status::Failed("cannot read " + (store_ / folder).string() + ": " + error.message());
    std::sort(files.begin(), files.end());
    const bool fresh = std::any_of(files.begin(), files.end(), [this](const fs::path& file) {
      return file.extension() == ".seg" && !Unchanged(file);
    });
    if (fresh) SLX_RETURN_IF_ERROR(VerifyFolder(store_ / folder).status());
    for (const fs::path& file : files) SLX_RETURN_IF_ERROR(Copy(file));
    return Status::Ok();
  }

  // What an earlier backup holds and this one does not: forgotten sessions must not outlive their deletion here.
  Status RemoveOthers() {
    std::error_code error;
    std::set<fs::path> keep;
    for (const auto& [path, file] : list_.files) keep.insert(to_ / path);
    std::vector<fs::path> gone;
    for (const char* part : {"sessions", "deletions"})
      for (auto entry = fs::recursive_directory_iterator(to_ / part, error);
           !error && entry != fs::recursive_directory_iterator(); entry.increment(error))
        if (entry->is_regular_file(error) && !keep.contains(entry->path())) gone.push_back(entry->path());
    for (const fs::path& file : gone) {
      if (!fs::remove(file, error)) return Status::Failed("cannot remove " + file.string() + ": " + error.message());
      ++report_.files_removed;
      for (fs::path up = file.parent_path(); up != to_ && fs::is_empty(up, error); up = up.parent_path())
        fs::remove(up, error);
    }
    return Status::Ok();
  }

  Status WriteList() {
    list_.made_wall = WallNow();
    list_.program_version = kVersion;
    return WriteFileList(to_, list_);
  }

 private:
  fs::path store_, to_;
  BackupReport& report_;
  FileList earlier_, list_;
};

// In the copy: only sessions whose files are in the backup.
Status DropUnfinished(const fs::path& to, BackupReport& report, std::vector<std::string>& ids) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(to, AccessMode::kReadWrite));
  SLX_ASSIGN_OR_RETURN(const auto sessions, index.Sessions());
  for (const SessionSummary& row : sessions) {
    if (row.info.status == SessionStatus::kRecording) {
      report.left_out.push_back(row.info.id);
    } else {
      ids.push_back(row.info.id);
    }
  }
  SLX_RETURN_IF_ERROR(index.connection().Execute("DELETE FROM sessions WHERE status = 'recording'"));
  return index.connection().Execute("PRAGMA journal_mode = DELETE");
}

Status CheckTarget(const fs::path& store, const fs::path& to) {
  std::error_code error;
  if (LiesIn(to, store)) return Status::Usage("--to " + to.string() + " lies within the store; choose another disk");
  const bool used = fs::exists(to, error) && !fs::is_empty(to, error);
  if (used && !fs::exists(to / "backup.json", error) && !fs::exists(to / "backup.unfinished", error))
    return Status::Usage(to.string() + " is neither empty nor an earlier backup; choose a folder of its own");
  return Status::Ok();
}

}  // namespace

Result<BackupReport> Backup(const fs::path& store, const BackupOptions& options, Logger& logger) {
  SLX_RETURN_IF_ERROR(SessionIndex::Open(store, AccessMode::kReadOnly).status());
  SLX_RETURN_IF_ERROR(CheckTarget(store, options.to));
  BackupReport report;
  SLX_RETURN_IF_ERROR(MakeFolder(options.to));
  SLX_RETURN_IF_ERROR(CopyKeys(store, options));
  SLX_RETURN_IF_ERROR(ReplaceFile(options.to / "backup.unfinished", "a backup is being made, or was interrupted\n"));
  // The files it lists are there and final when it says so; hence the index first.
  SLX_RETURN_IF_ERROR(MakeFolder(options.to / "index.new"));
  SLX_RETURN_IF_ERROR(Snapshot(store / "index.sqlite", options.to / "index.new" / "index.sqlite"));
  std::vector<std::string> ids;
  SLX_RETURN_IF_ERROR(DropUnfinished(options.to / "index.new", report, ids));
  Copier copier(store, options.to, report);
  {
    Progress progress(logger, "backup", static_cast<int64_t>(ids.size()));
    for (const std::string& id : ids) {
      if (!HasTombstone(store, id)) {
        SLX_RETURN_IF_ERROR(copier.CopySession(id).WithContext("session " + id));
        ++report.sessions;
      }
      progress.Advance();
    }
  }
  for (const fs::path& tombstone : ListTombstones(store))
    SLX_RETURN_IF_ERROR(copier.Copy(tombstone.lexically_relative(store)));
  std::error_code error;
  fs::rename(options.to / "index.new" / "index.sqlite", options.to / "index.sqlite", error);
  if (error) return Status::Failed("cannot move the index into " + options.to.string() + ": " + error.message());
  fs::remove_all(options.to / "index.new", error);
  SLX_RETURN_IF_ERROR(copier.List("index.sqlite"));
  SLX_RETURN_IF_ERROR(copier.WriteList());
  SLX_RETURN_IF_ERROR(copier.RemoveOthers());
  fs::remove(options.to / "backup.unfinished", error);
  return report;
}

}  // namespace stratalux::db
