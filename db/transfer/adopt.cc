// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/adopt.h"

#include "db/base/durable_file.h"
#include "db/base/write_lock.h"
#include "db/care/session_rebuild.h"
#include "db/care/verify_payloads.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/manifest.h"
#include "db/keys/rig_key.h"
#include "db/keys/sealed_key.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

// No link, which would name bytes that are not the session's.
bool IsPlainFile(const fs::path& file) {
  std::error_code error;
  return fs::is_regular_file(fs::symlink_status(file, error));
}

// Each payload decoded and held against its pixel hash, on all cores; one whose key is not here against its own hash.
Status VerifyPixels(const SegmentReader& reader, const std::vector<SegmentFrame>& frames, const fs::path& keys_of) {
  VerifyReport report;
  CheckPayloads(keys_of, reader, frames, report);
  if (report.problems.empty()) return Status::Ok();
  const size_t more = report.problems.size() - 1;
  return Status::Integrity(report.problems[0] + (more > 0 ? "; and " + std::to_string(more) + " more frames" : ""));
}

// `keys_of`: the store whose keys open the payloads, which are then decoded; null: their hashes are enough.
Status VerifySegment(const fs::path& file, const SessionInfo& info, const fs::path* keys_of, int64_t& frames) {
  SLX_ASSIGN_OR_RETURN(const auto reader, SegmentReader::Open(file));
  if (reader.session_id() != info.id)
    return Status::Integrity(file.string() + " belongs to session " + reader.session_id());
  bool sealed = false;
  SLX_ASSIGN_OR_RETURN(const auto found, reader.Walk(keys_of == nullptr, &sealed));
  if (keys_of != nullptr) SLX_RETURN_IF_ERROR(VerifyPixels(reader, found, *keys_of));
  // The writer of a failed session may have been stopped before it could seal.
  if (!sealed && info.status != SessionStatus::kFailed)
    return Status::Integrity(file.string() + ": truncated: it has no footer");
  if (file.filename() != "truth.seg") frames += static_cast<int64_t>(found.size());
  return Status::Ok();
}

// A segment that was sealed anew is whole, and not the one of this session.
Status VerifyListed(const fs::path& folder, const ManifestContents& contents) {
  for (const auto& listed : contents.files) {
    if (listed.name.empty() || listed.name.find('/') != std::string::npos || !IsPlainFile(folder / listed.name))
      return Status::Integrity((folder / "manifest.json").string() + " names " + listed.name + ", which is not there");
    SLX_ASSIGN_OR_RETURN(const auto there, DescribeFile(folder, listed.name));
    if (there.bytes != listed.bytes || there.hash != listed.hash)
      return Status::Integrity((folder / listed.name).string() + " is not the file that the manifest describes");
  }
  return Status::Ok();
}

// VerifyFolder; `keys_of` as VerifySegment has it.
Result<int64_t> VerifyFiles(const fs::path& folder, const fs::path* keys_of) {
  SLX_ASSIGN_OR_RETURN(const SessionInfo info, ReadManifest(folder));
  SLX_ASSIGN_OR_RETURN(const ManifestContents contents, ReadManifestContents(folder));
  if (info.status == SessionStatus::kRecording)
    return Status::Integrity((folder / "manifest.json").string() + ": the session is not finished");
  int64_t frames = 0;
  std::error_code error;
  for (const std::string& name : contents.segments) {
    if (name.empty() || name.find('/') != std::string::npos || !IsPlainFile(folder / name))
      return Status::Integrity((folder / "manifest.json").string() + " names " + name + ", which is not there");
    SLX_RETURN_IF_ERROR(VerifySegment(folder / name, info, keys_of, frames));
  }
  if (fs::exists(folder / "truth.seg", error))
    SLX_RETURN_IF_ERROR(VerifySegment(folder / "truth.seg", info, keys_of, frames));
  if (frames != contents.frames)
    return Status::Integrity((folder / "manifest.json").string() + " lists " + std::to_string(contents.frames) +
                             " frames, its segments hold " + std::to_string(frames));
  SLX_RETURN_IF_ERROR(VerifyListed(folder, contents));
  return frames;
}

Result<int64_t> Check(const fs::path& folder, const fs::path* keys_of) {
  auto checked = [&]() -> Result<int64_t> {
    SLX_ASSIGN_OR_RETURN(const int64_t frames, VerifyFiles(folder, keys_of));
    // Right hashes prove that nobody changed a header, not that this program understands it: CheckSession is asked.
    SLX_ASSIGN_OR_RETURN(const RebuiltSession session, RebuildSession(folder));
    if (static_cast<int64_t>(session.frames.size()) != frames)
      return Status::Integrity(folder.string() + " holds " + std::to_string(frames) + " frames, of which " +
                               std::to_string(session.frames.size()) + " can be listed");
    return frames;
  }();
  if (checked.status().code() == StatusCode::kFailed || checked.status().code() == StatusCode::kNotFound)
    return Status::Integrity(checked.status().message());
  return checked;
}

}  // namespace

Result<int64_t> NextNumber(SessionIndex& index) {
  SLX_ASSIGN_OR_RETURN(const int64_t last,
                       index.connection().QueryInteger("SELECT coalesce(max(seq), 0) FROM sqlite_sequence"
                                                       " WHERE name = 'sessions'"));
  return last + 1;
}

Result<int64_t> VerifyFolder(const fs::path& folder) { return VerifyFiles(folder, nullptr); }
Result<int64_t> CheckFolder(const fs::path& folder) { return Check(folder, nullptr); }
Result<int64_t> ProveFolder(const fs::path& store, const fs::path& folder) { return Check(folder, &store); }

namespace {

// The caller holds the write lock.
Status InsertAdopted(const fs::path& store, const RebuiltSession& session, const std::string& from) {
  const fs::path folder = store / "sessions" / session.info.id;
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadWrite));
  SLX_ASSIGN_OR_RETURN(const int64_t number, NextNumber(index));
  SLX_RETURN_IF_ERROR(WritePlace(folder, {number, from}));
  return InsertRebuilt(index, session, number).status();
}

}  // namespace

Status AdoptFolder(const fs::path& store, const fs::path& folder, const std::string& from) {
  SLX_ASSIGN_OR_RETURN(const SessionInfo info, ReadManifest(folder));
  const fs::path target = store / "sessions" / info.id;
  if (info.id.empty() || info.id.find('/') != std::string::npos || info.id.starts_with('.'))
    return Status::Integrity((folder / "manifest.json").string() + ": '" + info.id + "' is not a session id");
  SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store));  // a reindex would not see the new row
  // Under the lock, which a forgetting takes as well: none can begin between the answer and the move.
  SLX_RETURN_IF_ERROR(RefuseForgotten(store, info.id));
  std::error_code error;
  if (fs::exists(target, error)) return Status::Usage("session " + info.id + " is in " + store.string() + " already");
  // What no index takes is not moved: there it would keep out every later one.
  SLX_ASSIGN_OR_RETURN(const RebuiltSession session, RebuildSession(folder));
  SLX_RETURN_IF_ERROR(SyncTree(folder));
  fs::rename(folder, target, error);
  if (error)
    return Status::Failed("cannot move " + folder.string() + " to " + target.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(SyncFolder(target.parent_path()));
  return InsertAdopted(store, session, from);
}

Status ListAdopted(const fs::path& store, const std::string& id, const std::string& from) {
  SLX_RETURN_IF_ERROR(CheckFolder(store / "sessions" / id).status());
  SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store));
  SLX_RETURN_IF_ERROR(RefuseForgotten(store, id));
  SLX_ASSIGN_OR_RETURN(const RebuiltSession session, RebuildSession(store / "sessions" / id));
  return InsertAdopted(store, session, from);
}

Result<bool> AdoptSealedKey(const fs::path& store, const std::string& id, const fs::path& file) {
  SLX_ASSIGN_OR_RETURN(const std::string bytes, ReadSealedKeyBytes(file));
  const fs::path target = store / "sessions" / id / file.filename();
  if (const auto there = ReadFile(target); there.ok() && *there == bytes) return false;
  SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store));
  SLX_RETURN_IF_ERROR(RefuseForgotten(store, id));
  KeyId key{};
  {
    SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
    SLX_ASSIGN_OR_RETURN(const int64_t number, index.NumberOf(id));
    SLX_ASSIGN_OR_RETURN(const SessionRow row, index.Session(number));
    if (!FromHex(row.key_id, key).ok())
      return Status::Integrity(file.string() + " is a sealed key, but session " + id + " is not encrypted");
  }
  SLX_RETURN_IF_ERROR(CheckSealedKey(file, id, key));
  SLX_RETURN_IF_ERROR(ReplaceFile(target, bytes));
  return true;
}

Result<std::set<std::string>> ListedSessions(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT id FROM sessions"));
  std::set<std::string> ids;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return ids;
    ids.insert(select.Text(0));
  }
}

bool IsTroubleOfAll(const Status& status) {
  return status.code() == StatusCode::kFailed || status.code() == StatusCode::kBusy ||
         status.code() == StatusCode::kTryAgain;
}

}  // namespace stratalux::db
