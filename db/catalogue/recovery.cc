// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/recovery.h"

#include <algorithm>
#include <map>

#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/base/write_lock.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/signature.h"
#include "db/segment/segment.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

struct Cut {
  fs::path file;
  int64_t size = 0, keep = 0;  // keep 0: the file holds nothing that counts and goes
};

// What lies in a session's folder, against what the index acknowledged.
struct Findings {
  std::vector<Cut> cuts;
  std::vector<std::string> segments;  // that stay, in order
  RecoveryNotes notes;
  int64_t frames = 0;
};

std::string BytesText(int64_t bytes) { return std::to_string(bytes) + (bytes == 1 ? " byte" : " bytes"); }

std::vector<fs::path> FilesOf(const fs::path& folder) {
  std::vector<fs::path> files;
  std::error_code error;
  for (auto entry = fs::directory_iterator(folder, error); !error && entry != fs::end(entry); entry.increment(error))
    files.push_back(entry->path());
  std::sort(files.begin(), files.end());
  return files;
}

// kAcknowledgedOnly: memory shows more of the file than may be on the disk.
enum class Trust { kMemory, kAcknowledgedOnly };

// `acknowledged`: where the last acknowledged frame ends; 0 without one.
void Examine(const fs::path& file, int64_t acknowledged, Trust trust, Findings& found) {
  const std::string name = file.filename().string();
  std::error_code error;
  if (!fs::is_regular_file(fs::symlink_status(file, error)))
    return found.notes.push_back(name + " is not a regular file and was left as it is");
  const auto size = static_cast<int64_t>(fs::file_size(file, error));
  const auto reader = SegmentReader::Open(file);
  // A footer is written once all frames before it are acknowledged: nothing of the file is to be cut.
  if (trust == Trust::kMemory && reader.ok() && reader->SealedFrames()) {
    if (reader->frames_end() > std::max(acknowledged, kSegmentStart) && name != "truth.seg")
      found.notes.push_back(name + " holds frames that the index does not know, and was kept: `stratalux-db reindex`");
    return found.segments.push_back(name);
  }
  int64_t keep = acknowledged;
  if (trust == Trust::kMemory && name == "truth.seg" && reader.ok()) keep = reader->IntactEnd();
  if (keep <= kSegmentStart) keep = 0;
  if (keep > size)
    found.notes.push_back(name + " lacks the last " + BytesText(keep - size) + " of acknowledged frames");
  if (keep < size || keep == 0) found.cuts.push_back({file, size, keep});
  if (keep > 0) found.segments.push_back(name);
}

Result<Findings> Examine(SessionIndex& index, const fs::path& store, const SessionRow& session,
                         const std::vector<std::string>& doubtful) {
  Findings found;
  SLX_ASSIGN_OR_RETURN(const int64_t number, index.NumberOf(session.info.id));
  SLX_ASSIGN_OR_RETURN(const auto places, index.Places(number));
  found.frames = static_cast<int64_t>(places.size());
  std::map<std::string, int64_t> ends;
  for (const auto& p : places) {
    int64_t& end = ends[SegmentName(p.segment)];
    end = std::max(end, p.offset + static_cast<int64_t>(sizeof(FrameHeader)) + p.bytes);
  }
  const auto folder = store / "sessions" / session.info.id;
  for (const fs::path& file : FilesOf(folder)) {
    const std::string name = file.filename().string();
    const auto end = ends.find(name);
    const bool doubted = std::find(doubtful.begin(), doubtful.end(), name) != doubtful.end();
    if (file.extension() == ".seg")
      Examine(file, end == ends.end() ? 0 : end->second, doubted ? Trust::kAcknowledgedOnly : Trust::kMemory, found);
    if (name == "manifest.json.new") found.cuts.push_back({file, 0, 0});
  }
  for (const auto& [name, end] : ends)
    if (std::error_code error; !fs::exists(folder / name, error))
      found.notes.push_back(name + " is missing, and acknowledged frames with it: restore it from a copy");
  std::erase(found.segments, "truth.seg");
  return found;
}

Status Apply(const Findings& found, const fs::path& folder) {
  SLX_RETURN_IF_ERROR(MakeFolder(folder));
  for (const Cut& cut : found.cuts) {
    if (cut.keep > 0) {
      SLX_RETURN_IF_ERROR(CutFile(cut.file, cut.keep));
    } else if (std::error_code error; !fs::remove(cut.file, error) && error) {
      return Status::Failed("cannot remove " + cut.file.string() + ": " + error.message());
    }
  }
  // What stays was read from memory: a writer that was killed may not have synced its last footer or truth map.
  return SyncTree(folder);
}

enum class Tense { kDone, kWould };

void Describe(const Findings& found, const std::string& id, Tense tense, RecoveryNotes& notes) {
  for (const Cut& cut : found.cuts) {
    const std::string what = tense == Tense::kDone ? " cut" : " to be cut";
    if (cut.size > cut.keep)
      notes.push_back("session " + id + ": " + BytesText(cut.size - cut.keep) + what + " from " +
                      cut.file.filename().string() + ", never acknowledged");
  }
  for (const std::string& note : found.notes) notes.push_back("session " + id + ": " + note);
}

// The manifest is written last: where it is whole, the session is.
Result<SessionInfo> EndOf(const fs::path& folder, const std::string& id) {
  SLX_ASSIGN_OR_RETURN(SessionInfo info, ReadManifest(folder));
  if (info.id != id || info.status == SessionStatus::kRecording)
    return Status::Integrity((folder / "manifest.json").string() + " is not of a finished session " + id);
  return info;
}

std::string ReasonFor(int64_t frames) {
  return "the writer stopped before the session was finished; " + std::to_string(frames) + " acknowledged frames kept";
}

Status RecoverOne(SessionIndex& index, const fs::path& store, const SessionRow& session, RecoveryNotes& notes) {
  const std::string& id = session.info.id;
  if (const auto end = EndOf(store / "sessions" / id, id); end.ok()) {
    SLX_ASSIGN_OR_RETURN(const int64_t number, index.NumberOf(id));
    SLX_RETURN_IF_ERROR(SyncTree(store / "sessions" / id));  // seen in memory, perhaps not yet on the disk
    SLX_RETURN_IF_ERROR(index.SetStatus(number, EndingOf(*end)));
    notes.push_back("session " + id + ": ended as its manifest says: " + ToString(end->status));
    return Status::Ok();
  }
  SLX_RETURN_IF_ERROR(AbandonSession(index, store, session, ReasonFor(session.frames), {}, notes));
  notes.push_back("session " + id + ": ended as failed: " + ReasonFor(session.frames));
  return Status::Ok();
}

}  // namespace

Status AbandonSession(SessionIndex& index, const fs::path& store, const SessionRow& session, const std::string& reason,
                      const std::vector<std::string>& doubtful, RecoveryNotes& notes) {
  const auto folder = store / "sessions" / session.info.id;
  SLX_ASSIGN_OR_RETURN(const Findings found, Examine(index, store, session, doubtful));
  SLX_ASSIGN_OR_RETURN(const int64_t number, index.NumberOf(session.info.id));
  SLX_RETURN_IF_ERROR(Apply(found, folder));
  Describe(found, session.info.id, Tense::kDone, notes);
  SessionInfo info = session.info;
  // Which no row of the index has.
  if (const auto begun = ReadManifest(folder); begun.ok()) info.devices = begun->devices;
  info.status = SessionStatus::kFailed;
  info.reasons = {reason};
  info.finished_wall = WallNow();
  // At its own rig a session is signed as it ends, also one that failed: else a forger could make any session fail.
  std::error_code error;
  Status manifest = Status::Failed("the store has no rig key");
  if (fs::exists(RigKeyFile(store), error))
    manifest = WriteEnding(store, info, found.frames, found.segments, EndingSignature::kByRigKey);
  if (!manifest.ok()) manifest = WriteEnding(store, info, found.frames, found.segments, EndingSignature::kNone);
  // On a full disk the row alone must do, unless an older manifest says that the session ended otherwise.
  if (!manifest.ok() && EndOf(folder, session.info.id).ok()) return manifest;
  return index.SetStatus(number, EndingOf(info));
}

Result<RecoveryNotes> RecoverSessions(SessionIndex& index, const fs::path& store) {
  RecoveryNotes notes;
  SLX_ASSIGN_OR_RETURN(const bool any, index.HasUnfinished());
  if (!any) return notes;
  const auto lock = WriteLock::TryTake(store);
  if (lock.status().code() == StatusCode::kBusy) return notes;  // a live writer: its session is its own
  if (!lock.ok()) return FindUnfinished(index, store);
  // A writer that died between writing the log and syncing it leaves frames that the index lists in memory alone. What
  // follows is made durable on their word.
  SLX_RETURN_IF_ERROR(SyncFile(store / "index.sqlite-wal"));
  SLX_ASSIGN_OR_RETURN(const auto sessions, index.Recording());
  for (const SessionRow& session : sessions)
    if (const Status ended = RecoverOne(index, store, session, notes); !ended.ok())
      notes.push_back("session " + session.info.id +
                      ": could not be ended, the next program that opens the store tries again: " + ended.message());
  return notes;
}

Result<RecoveryNotes> FindUnfinished(SessionIndex& index, const fs::path& store) {
  RecoveryNotes notes;
  SLX_ASSIGN_OR_RETURN(const bool any, index.HasUnfinished());
  if (!any || WriteLock::IsHeld(store)) return notes;
  SLX_ASSIGN_OR_RETURN(const auto sessions, index.Recording());
  for (const SessionRow& session : sessions) {
    const std::string& id = session.info.id;
    notes.push_back("session " + id + ": its writer is gone; the next program that writes to the store ends it");
    if (EndOf(store / "sessions" / id, id).ok()) continue;
    SLX_ASSIGN_OR_RETURN(const Findings found, Examine(index, store, session, {}));
    Describe(found, id, Tense::kWould, notes);
  }
  return notes;
}

}  // namespace stratalux::db
