// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/backup_folder.h"

#include <algorithm>
#include <iterator>
#include <sstream>

#include <fcntl.h>

#include "db/base/descriptor.h"
#include "db/base/durable_file.h"
#include "db/base/listing.h"
#include "db/catalogue/artifact_record.h"
#include "db/keys/sealed_key.h"
#include "db/transfer/adopt.h"
#include "db/transfer/file_copy.h"
#include "shared/base/read_file.h"
#include "shared/base/version.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
constexpr int64_t kScrubRuns = 8;

int64_t SizeOf(const fs::path& file) {
  std::error_code error;
  const auto bytes = fs::file_size(file, error);
  return error ? -1 : static_cast<int64_t>(bytes);
}

bool HasHash(const fs::path& file, const std::string& expected) {
  const auto hash = HashFile(file);
  return hash.ok() && *hash == expected;
}

Status Move(const fs::path& from, const fs::path& to) {
  std::error_code error;
  fs::rename(from, to, error);
  if (error) return Status::Failed("cannot move " + from.string() + " to " + to.string() + ": " + error.message());
  return SyncFolder(to.parent_path());
}

// A fit is copied as it is: its hashes are its own affair. All else makes the session.
bool IsOfFit(const std::string& path) { return path.find("/fits/") != std::string::npos; }

}  // namespace

fs::path WaitingFile(const fs::path& file) { return file.string() + ".backup-new"; }

Result<BackupFolder> BackupFolder::Open(const fs::path& store, const fs::path& to, BackupReport& report) {
  BackupFolder folder(store, to, report);
  auto earlier = ReadFileList(to);
  if (earlier.ok()) folder.earlier_ = std::move(earlier).value();
  if (earlier.status().code() == StatusCode::kNewerSchema) return earlier.status();
  if (!earlier.ok() && earlier.status().code() != StatusCode::kNotFound)
    report.problems.push_back("the backup's list could not be read, every file is copied again: " +
                              earlier.status().message());
  if (!folder.earlier_.intact)
    report.problems.push_back((to / "backup.json").string() +
                              " did not match its own hash: copies that it no longer listed may be left behind");
  SLX_RETURN_IF_ERROR(folder.GoOn());
  return folder;
}

// After a run that was broken off: what its list names takes its place, what its journal names is used again.
Status BackupFolder::GoOn() {
  const fs::path file = to_ / kBackupJournal;
  std::error_code error;
  if (!fs::exists(file, error)) return ReplaceFile(file, "a backup is being made, or was interrupted\n");
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file, kAnyFileSize));
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);)
    if (auto entry = ParseListedFileLine(line)) journal_[entry->first] = std::move(entry->second);
  for (const auto& [path, listed] : earlier_.files) {
    const fs::path waiting = WaitingFile(to_ / path);
    if (!fs::exists(waiting, error) || !HasHash(waiting, listed.hash)) continue;
    SLX_RETURN_IF_ERROR(Move(waiting, to_ / path));
    journal_.erase(path);
  }
  // A torn last line would swallow the next one.
  return text.ends_with('\n') ? Status::Ok() : ReplaceFile(file, text + "\n");
}

bool BackupFolder::Unchanged(const std::string& path, const ListedFile& known) const {
  const auto time = ModifiedNs(store_ / path);
  return time.ok() && *time == known.source_mtime_ns && SizeOf(store_ / path) == known.bytes;
}

bool BackupFolder::TakeFromJournal(const std::string& path) {
  const auto entry = journal_.find(path);
  if (entry == journal_.end() || !Unchanged(path, entry->second)) return false;
  const bool waits = earlier_.files.contains(path);
  if (!HasHash(waits ? WaitingFile(to_ / path) : to_ / path, entry->second.hash)) return false;
  list_.files[path] = entry->second;
  if (waits) waiting_.insert(path);
  ++report_->files_continued;
  return true;
}

Status BackupFolder::Note(const std::string& path, const ListedFile& file) {
  const UniqueFd journal = OpenDescriptor(to_ / kBackupJournal, O_WRONLY | O_APPEND);
  if (!journal.ok()) return Status::Failed("cannot write " + (to_ / kBackupJournal).string());
  const std::string line = ListedFileLine(path, file) + "\n";
  return WriteAll(journal.get(), line.data(), line.size(), (to_ / kBackupJournal).string());
}

Status BackupFolder::CopyFile(const std::string& path) {
  const auto known = earlier_.files.find(path);
  if (known != earlier_.files.end() && Unchanged(path, known->second)) {
    list_.files[path] = known->second;
    kept_.insert(path);
    ++report_->files_kept;
    if (SizeOf(to_ / path) == known->second.bytes) return Status::Ok();
    return Mend(path, list_.files[path]);
  }
  if (TakeFromJournal(path)) return Status::Ok();
  const bool waits = known != earlier_.files.end();
  const fs::path target = waits ? WaitingFile(to_ / path) : to_ / path;
  ListedFile file;
  SLX_ASSIGN_OR_RETURN(file.source_mtime_ns, ModifiedNs(store_ / path));
  SLX_ASSIGN_OR_RETURN(file.hash, CopyFileHashed(store_ / path, target, ""));
  file.bytes = SizeOf(target);
  file.checked_wall = WallNow();
  list_.files[path] = file;
  if (waits) waiting_.insert(path);
  ++report_->files_copied;
  report_->bytes_copied += file.bytes;
  return Note(path, file);
}

Status BackupFolder::PlaceFile(const fs::path& beside, const std::string& path) {
  ListedFile file;
  SLX_ASSIGN_OR_RETURN(file.hash, HashFile(beside));
  file.bytes = SizeOf(beside);
  file.checked_wall = WallNow();
  const bool waits = earlier_.files.contains(path);
  SLX_RETURN_IF_ERROR(SyncFile(beside));
  SLX_RETURN_IF_ERROR(Move(beside, waits ? WaitingFile(to_ / path) : to_ / path));
  if (waits) waiting_.insert(path);
  list_.files[path] = file;
  return Status::Ok();
}

Result<std::vector<std::string>> BackupFolder::FilesOf(const std::string& id) const {
  std::vector<std::string> files;
  std::error_code error;
  const fs::path folder = store_ / "sessions" / id;
  for (auto entry = fs::recursive_directory_iterator(folder, error);
       !error && entry != fs::recursive_directory_iterator(); entry.increment(error)) {
    if (entry->path().extension() == ".partial" || entry->path() == folder / kArtifactsFolder) {
      entry.disable_recursion_pending();  // a fit that is being made; what is made again where it is wanted
    } else if (entry.depth() == 0 && IsSealedKeyName(entry->path().filename().string())) {
      continue;  // no key goes into a backup, not for a reader either: it outlives what is forgotten
    } else if (entry->is_symlink(error)) {
      return Status::Integrity(entry->path().string() + " is a symbolic link; a session must hold its own files");
    } else if (entry->is_regular_file(error)) {
      files.push_back(entry->path().lexically_relative(store_).string());
    }
  }
  if (error) return Status::Integrity("cannot read " + folder.string() + ": " + error.message());
  std::sort(files.begin(), files.end());
  return files;
}

// Something of it is new, has changed or is gone since the earlier backup.
bool BackupFolder::MustVerify(const std::string& id, const std::vector<std::string>& files) const {
  for (const std::string& path : files) {
    const auto known = earlier_.files.find(path);
    if (!IsOfFit(path) && (known == earlier_.files.end() || !Unchanged(path, known->second))) return true;
  }
  const std::string prefix = "sessions/" + id + "/";
  for (auto known = earlier_.files.lower_bound(prefix);
       known != earlier_.files.end() && known->first.starts_with(prefix); ++known)
    if (!IsOfFit(known->first) && !std::binary_search(files.begin(), files.end(), known->first)) return true;
  return false;
}

Result<BackupFolder::Seen> BackupFolder::LookAt(const std::string& id) const {
  SLX_ASSIGN_OR_RETURN(const auto files, FilesOf(id));
  Seen seen;
  for (const std::string& path : files) {
    if (IsOfFit(path)) continue;
    SLX_ASSIGN_OR_RETURN(const int64_t time, ModifiedNs(store_ / path));
    seen[path] = {time, SizeOf(store_ / path)};
  }
  return seen;
}

Status BackupFolder::CopyOnce(const std::string& id) {
  Status status;
  const auto files = FilesOf(id);
  if (!files.ok()) {
    status = files.status();
  } else if (MustVerify(id, *files)) {
    status = VerifyFolder(store_ / "sessions" / id).status();
    // Not the target's trouble, whatever it is called.
    if (status.code() == StatusCode::kFailed) status = Status::Integrity(status.message());
  }
  for (size_t i = 0; status.ok() && i < files->size(); ++i) status = CopyFile((*files)[i]);
  return status;
}

// A transcode puts other segments and another manifest in their place: of both states copied, neither is whole.
Status BackupFolder::CopySession(const std::string& id) {
  Status status;
  for (const bool first : {true, false}) {
    const int64_t kept = report_->files_kept, continued = report_->files_continued;
    const auto before = LookAt(id);
    status = CopyOnce(id);
    if (status.code() == StatusCode::kFailed) return status;
    const auto after = LookAt(id);
    if (before.ok() == after.ok() && (!before.ok() || *before == *after)) break;
    status = Status::Integrity((store_ / "sessions" / id).string() + " changed while it was copied, twice");
    if (!first) break;
    DropSession(id);
    report_->files_kept = kept;
    report_->files_continued = continued;
  }
  if (status.ok()) return status;
  DropSession(id);
  KeepSession(id);
  return status;
}

bool BackupFolder::KeepSession(const std::string& id) {
  const std::string prefix = "sessions/" + id + "/";
  bool any = false;
  for (auto known = earlier_.files.lower_bound(prefix);
       known != earlier_.files.end() && known->first.starts_with(prefix); ++known) {
    list_.files[known->first] = known->second;
    kept_.insert(known->first);
    any = true;
  }
  return any;
}

void BackupFolder::DropSession(const std::string& id) {
  const std::string prefix = "sessions/" + id + "/";
  auto of_session = [&prefix](const auto& entry) {
    if constexpr (requires { entry.first; })
      return entry.first.starts_with(prefix);
    else
      return entry.starts_with(prefix);
  };
  std::erase_if(list_.files, of_session);
  std::erase_if(waiting_, of_session);
  std::erase_if(kept_, of_session);
}

std::set<std::string> BackupFolder::EarlierSessions() const {
  std::set<std::string> sessions;
  for (const auto& [path, file] : earlier_.files)
    if (const std::string id = SessionOfPath(path); !id.empty()) sessions.insert(id);
  return sessions;
}

// The copy is not what the list says. The store's file of the same size and time is, or both are lost.
Status BackupFolder::Mend(const std::string& path, ListedFile& file) {
  const auto copied = CopyFileHashed(store_ / path, to_ / path, file.hash);
  if (copied.status().code() == StatusCode::kFailed) return copied.status();
  file.checked_wall = copied.ok() ? WallNow() : WallNs{};
  if (copied.ok()) {
    report_->mended.push_back(path);
  } else {
    report_->problems.push_back((to_ / path).string() + " is damaged in the backup, and the store has no good one: " +
                                copied.status().message());
  }
  return Status::Ok();
}

Status BackupFolder::Scrub(ScrubShare share) {
  const WallNs now = WallNow();
  std::vector<std::pair<int64_t, std::string>> oldest;
  // A check that lies in the future was dated by a wrong clock: as good as none.
  for (const std::string& path : kept_) {
    const int64_t checked = list_.files[path].checked_wall.ns;
    oldest.emplace_back(checked > now.ns ? 0 : checked, path);
  }
  std::sort(oldest.begin(), oldest.end());
  const auto all = static_cast<int64_t>(oldest.size());
  const int64_t count = share == ScrubShare::kAll ? all : (all + kScrubRuns - 1) / kScrubRuns;
  for (int64_t i = 0; i < count; ++i) {
    const std::string& path = oldest[static_cast<size_t>(i)].second;
    ListedFile& file = list_.files[path];
    ++report_->files_reread;
    if (HasHash(to_ / path, file.hash)) {
      file.checked_wall = now;
    } else {
      SLX_RETURN_IF_ERROR(Mend(path, file));
    }
  }
  return Status::Ok();
}

// What an earlier backup holds and this one does not: forgotten sessions must not outlive their deletion here.
Status BackupFolder::RemoveOthers() {
  std::error_code error;
  std::vector<fs::path> gone;
  for (const char* part : {"sessions", "deletions"}) {
    SLX_ASSIGN_OR_RETURN(const std::vector<fs::path> files, FilesUnder(to_ / part));
    std::ranges::copy_if(files, std::back_inserter(gone), [this](const fs::path& file) {
      return !list_.files.contains(file.lexically_relative(to_).string());
    });
  }
  for (const fs::path& file : gone) {
    if (!fs::remove(file, error)) return Status::Failed("cannot remove " + file.string() + ": " + error.message());
    ++report_->files_removed;
    for (fs::path up = file.parent_path(); up != to_ && fs::is_empty(up, error); up = up.parent_path())
      fs::remove(up, error);
  }
  return Status::Ok();
}

Status BackupFolder::Finish() {
  list_.made_wall = WallNow();
  list_.program_version = kVersion;
  list_.scrub_runs = kScrubRuns;
  list_.problems = report_->problems;
  SLX_RETURN_IF_ERROR(WriteFileList(to_, list_));
  for (const std::string& path : waiting_) SLX_RETURN_IF_ERROR(Move(WaitingFile(to_ / path), to_ / path));
  SLX_RETURN_IF_ERROR(RemoveOthers());
  std::error_code error;
  fs::remove(to_ / kBackupJournal, error);
  return SyncFolder(to_);
}

}  // namespace stratalux::db
