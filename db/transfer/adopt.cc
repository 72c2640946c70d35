// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/adopt.h"

#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/base/write_lock.h"
#include "db/care/session_rebuild.h"
#include "db/catalogue/manifest.h"
#include "db/ledger/tombstone.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

Result<int64_t> NextNumber(SessionIndex& index) {
  SLX_ASSIGN_OR_RETURN(const int64_t last,
                       index.connection().QueryInteger("SELECT coalesce(max(seq), 0) FROM sqlite_sequence"
                                                       " WHERE name = 'sessions'"));
  return last + 1;
}

Status VerifySegment(const fs::path& file, const SessionInfo& info, int64_t& frames) {
  SLX_ASSIGN_OR_RETURN(const auto reader, SegmentReader::Open(file));
  if (reader.session_id() != info.id)
    return Status::Integrity(file.string() + " belongs to session " + reader.session_id());
  bool sealed = false;
  SLX_ASSIGN_OR_RETURN(const auto found, reader.Walk(true, &sealed));
  // The writer of a failed session may have been stopped before it could seal.
  if (!sealed && info.status != SessionStatus::kFailed)
    return Status::Integrity(file.string() + ": truncated: it has no footer");
  if (file.filename() != "truth.seg") frames += static_cast<int64_t>(found.size());
  return Status::Ok();
}

}  // namespace

Result<IncomingLock> IncomingLock::Take(const fs::path& store) {
  IncomingLock lock;
  const fs::path file = store / "incoming.lock";
  lock.fd_ = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0640);
  if (lock.fd_ < 0) return Status::Failed("cannot write store " + store.string() + ": " + std::strerror(errno));
  if (flock(lock.fd_, LOCK_EX | LOCK_NB) != 0)
    return Status::Busy("another pull or restore into " + store.string() +
                        " is running; try again when it has finished");
  return lock;
}
IncomingLock::IncomingLock(IncomingLock&& o) noexcept : fd_(std::exchange(o.fd_, -1)) {}
IncomingLock& IncomingLock::operator=(IncomingLock&& o) noexcept {
  std::swap(fd_, o.fd_);
  return *this;
}
IncomingLock::~IncomingLock() {
  if (fd_ >= 0) close(fd_);
}

Result<int64_t> VerifyFolder(const fs::path& folder) {
  SLX_ASSIGN_OR_RETURN(const SessionInfo info, ReadManifest(folder));
  SLX_ASSIGN_OR_RETURN(const ManifestContents contents, ReadManifestContents(folder));
  if (info.status == SessionStatus::kRecording)
    return Status::Integrity((folder / "manifest.json").string() + ": the session is not finished");
  int64_t frames = 0;
  std::error_code error;
  for (const std::string& name : contents.segments) {
    if (name.empty() || name.find('/') != std::string::npos || !fs::exists(folder / name, error))
      return Status::Integrity((folder / "manifest.json").string() + " names " + name + ", which is not there");
    SLX_RETURN_IF_ERROR(VerifySegment(folder / name, info, frames));
  }
  if (fs::exists(folder / "truth.seg", error)) SLX_RETURN_IF_ERROR(VerifySegment(folder / "truth.seg", info, frames));
  if (frames != contents.frames)
    return Status::Integrity((folder / "manifest.json").string() + " speaks of " + std::to_string(contents.frames) +
                             " frames, its segments hold " + std::to_string(frames));
  return frames;
}

Status AdoptFolder(const fs::path& store, const fs::path& folder, const std::string& from) {
  SLX_ASSIGN_OR_RETURN(const SessionInfo info, ReadManifest(folder));
  const fs::path target = store / "sessions" / info.id;
  if (info.id.empty() || info.id.find('/') != std::string::npos || info.id.starts_with('.'))
    return Status::Integrity((folder / "manifest.json").string() + ": '" + info.id + "' is no session id");
  if (HasTombstone(store, info.id)) return Status::Usage("session " + info.id + " was forgotten and cannot return");
  std::error_code error;
  if (fs::exists(target, error)) return Status::Usage("session " + info.id + " is in " + store.string() + " already");
  SLX_RETURN_IF_ERROR(SyncTree(folder));
  fs::rename(folder, target, error);
  if (error)
    return Status::Failed("cannot move " + folder.string() + " to " + target.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(SyncFolder(target.parent_path()));
  return ListAdopted(store, info.id, from);
}

Status ListAdopted(const fs::path& store, const std::string& id, const std::string& from) {
  const fs::path folder = store / "sessions" / id;
  SLX_ASSIGN_OR_RETURN(const auto session, RebuildSession(folder));
  SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store));  // a reindex would not see the new row
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadWrite));
  SLX_ASSIGN_OR_RETURN(const int64_t number, NextNumber(index));
  SLX_RETURN_IF_ERROR(WritePlace(folder, {number, from}));
  return InsertRebuilt(index, session, number).status();
}

}  // namespace stratalux::db
