// SPDX-License-Identifier: Apache-2.0
#include "db/care/session_rebuild.h"

#include <algorithm>
#include <charconv>
#include <map>
#include <set>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/care/session_gate.h"
#include "db/care/session_loss.h"
#include "db/catalogue/calibration_store.h"
#include "db/catalogue/consent_rows.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/manifest.h"
#include "db/keys/sealed_key.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

std::vector<fs::path> Sorted(const fs::path& folder) {
  std::vector<fs::path> paths;
  std::error_code error;
  for (auto entry = fs::directory_iterator(folder, error); !error && entry != fs::directory_iterator();
       entry.increment(error))
    paths.push_back(entry->path());
  std::sort(paths.begin(), paths.end());
  return paths;
}

std::optional<int64_t> SegmentNumber(const fs::path& file) {
  const std::string name = file.filename().string();
  if (!name.starts_with("frames-") || !name.ends_with(".seg")) return std::nullopt;
  int64_t number = 0;
  const char* end = name.data() + name.size() - 4;
  const auto parsed = std::from_chars(name.data() + 7, end, number);
  const bool is_number = parsed.ec == std::errc() && parsed.ptr == end && number > 0;
  return is_number && name == SegmentName(number) ? std::optional(number) : std::nullopt;
}

// Collects a session out of its segments.
class Rebuilder {
 public:
  Rebuilder(fs::path folder, RebuiltSession& session, LossWitnesses& witnesses)
      : folder_(std::move(folder)), session_(session), witnesses_(witnesses) {}

  void AddSegments() {
    std::vector<std::pair<int64_t, fs::path>> later;
    for (const fs::path& file : Sorted(folder_)) {
      const auto number = SegmentNumber(file);
      if (!number) continue;
      if (IsNamed(file))
        AddSegment(file, *number);
      else
        later.emplace_back(*number, file);
    }
    const size_t named = session_.frames.size();
    for (const auto& [number, file] : later) AddSegment(file, number);
    SortFrames(named);
  }
  [[nodiscard]] const std::vector<std::string>& segments() const { return segments_; }

 private:
  // By the manifest of a finished session; before that all count.
  bool IsNamed(const fs::path& file) const {
    if (!witnesses_.manifest) return true;
    const auto& names = witnesses_.manifest->segments;
    return std::find(names.begin(), names.end(), file.filename().string()) != names.end();
  }

  void AddSegment(const fs::path& file, int64_t number) {
    Status header;
    const auto reader = SegmentReader::OpenDamaged(file, &header);
    if (!reader.ok()) return session_.problems.push_back(reader.status().message());
    if (header.ok() && reader->session_id() != session_.info.id)
      return session_.problems.push_back(file.string() + " belongs to session " + reader->session_id() + "; left out");
    std::vector<KnownPlace> places;
    for (const KnownFrame& k : witnesses_.known)
      if (k.segment == number) places.push_back(k.place);
    const SegmentScan scan = ScanSegment(*reader, places);
    segments_.push_back(file.filename().string());
    const bool proven = CheckListed(file);
    for (const std::string& text : scan.findings) session_.problems.push_back(file.string() + ": " + text);
    for (const auto& lost : scan.lost) {
      session_.problems.push_back(file.string() + ": " + lost.why);
      witnesses_.steps.emplace(lost.frame, lost.step);
    }
    AddAsides(file, scan, reader->size());
    if (!header.ok()) return AddUnnamed(file, number, scan, header, proven ? nullptr : &places);
    for (const SegmentFrame& frame : scan.frames) session_.frames.emplace_back(number, frame);
  }

  // A segment that was sealed anew is whole, and not the one that the manifest speaks of. True where it is that one.
  bool CheckListed(const fs::path& file) {
    if (!witnesses_.manifest) return false;
    const std::string name = file.filename().string();
    for (const auto& listed : witnesses_.manifest->files) {
      if (listed.name != name) continue;
      const auto there = DescribeFile(folder_, name);
      if (there.ok() && !listed.hash.empty() && there->bytes == listed.bytes && there->hash == listed.hash) return true;
      if (there.ok() && (there->bytes != listed.bytes || there->hash != listed.hash))
        session_.problems.push_back(file.string() + " is not the file that the manifest describes");
    }
    return false;
  }

  // With a damaged file header, which names the session. All of its frames are this session's where its footer is the
  // one of the manifest (`known` null), else those of which the old index says so.
  void AddUnnamed(const fs::path& file, int64_t number, const SegmentScan& scan, const Status& header,
                  const std::vector<KnownPlace>* known) {
    int64_t left = 0;
    for (const SegmentFrame& f : scan.frames) {
      const bool by_index = known != nullptr &&
                            std::any_of(known->begin(), known->end(), [&f](const KnownPlace& k) { return IsAt(k, f); });
      // One of a later version may mean other things by the same bytes.
      const bool ours = header.code() != StatusCode::kNewerSchema && (known == nullptr || by_index);
      if (ours) {
        session_.frames.emplace_back(number, f);
      } else {
        ++left;
        witnesses_.steps.emplace(f.header.frame, f.header.step);
      }
    }
    const auto listed = static_cast<int64_t>(scan.frames.size()) - left;
    std::string text = header.message();
    if (listed > 0)
      text += "; " + std::to_string(listed) + " frames are known by the " +
              (known == nullptr ? "manifest's hash of its footer" : "old index") + " and stay listed";
    if (left > 0)
      text += "; " + std::to_string(left) + " frames stay in the file and are not listed: restore it from a copy";
    session_.problems.push_back(text);
    session_.asides.push_back({file, 0, kSegmentStart, "a damaged file header"});
  }

  void AddAsides(const fs::path& file, const SegmentScan& scan, int64_t size) {
    const SessionStatus status = session_.info.status;
    const bool finished = IsNamed(file) && (status == SessionStatus::kComplete || status == SessionStatus::kDegraded);
    for (const auto& aside : scan.asides) {
      session_.asides.push_back({file, aside.begin, aside.end, aside.what});
      const std::string text = file.string() + ": bytes " + std::to_string(aside.begin) + " to " +
                               std::to_string(aside.end) + " hold " + aside.what + "; set aside, not changed";
      // The end of what a writer never finished is as it must be.
      const bool open_tail = !finished && aside.end == size;
      (open_tail ? session_.notes : session_.problems).push_back(text);
    }
    if (finished && !scan.sealed && scan.asides.empty())
      session_.problems.push_back(file.string() + ": a finished session's segment must end with a footer");
  }

  // By number, each once. Of two the one stays whose segment the manifest names, else the first.
  void SortFrames(size_t named) {
    auto& frames = session_.frames;
    auto frame_of = [](const auto& f) { return f.second.header.frame; };
    std::set<int64_t> numbers;
    int64_t twice = 0, left = 0, unnamed = 0;
    std::vector<std::pair<int64_t, SegmentFrame>> once;
    for (size_t i = 0; i < frames.size(); ++i) {
      const bool fresh = numbers.insert(frame_of(frames[i])).second;
      if (fresh) once.push_back(frames[i]);
      if (i >= named) ++(fresh ? unnamed : left);
      if (i < named && !fresh) ++twice;
    }
    const std::string where = "session " + session_.info.id + ": ";
    if (twice > 0)
      session_.problems.push_back(where + std::to_string(twice) +
                                  " frames are there twice; the first of each was used");
    if (unnamed > 0)
      session_.problems.push_back(where + std::to_string(unnamed) +
                                  " frames were found only in segments that the manifest does not name");
    // A transcode that was stopped leaves both its own segments and those before: the manifest says which count.
    if (left > 0)
      session_.notes.push_back(where + std::to_string(left) +
                               " frames lie in segments that the manifest does not name as well; left out");
    std::sort(once.begin(), once.end(), [&](const auto& a, const auto& b) { return frame_of(a) < frame_of(b); });
    frames = std::move(once);
  }

  fs::path folder_;
  RebuiltSession& session_;
  LossWitnesses& witnesses_;
  std::vector<std::string> segments_;  // that are there and of this session
};

void AddFits(const fs::path& folder, RebuiltSession& session) {
  for (const fs::path& fit : Sorted(folder / "fits")) {
    if (fit.extension() == ".partial") continue;
    auto record = ReadFitRecord(fit, session.info.id);
    if (record.ok()) {
      auto calibration = ReadFitCalibration(fit);
      if (!calibration.ok()) session.problems.push_back(calibration.status().message());
      if (calibration.ok()) record->calibration_json = calibration->value_or("");
      session.fits.push_back(std::move(record).value());
    } else if (record.status().code() != StatusCode::kNotFound) {
      session.problems.push_back(record.status().message());
    } else {
      session.notes.push_back(fit.string() + " has no " + kFitRecordFile + ": no fit, or one that has lost it");
    }
  }
}

// What the manifest says, and what becomes of a session without one.
Status ReadInfo(const fs::path& folder, RebuiltSession& session, LossWitnesses& witnesses, Status& manifest_status) {
  auto manifest = ReadManifest(folder);
  manifest_status = manifest.status();
  if (manifest_status.code() == StatusCode::kNewerSchema) return manifest_status;
  if (!manifest.ok()) return Status::Ok();
  if (manifest->id != session.info.id)
    return Status::Integrity((folder / "manifest.json").string() + " is of session " + manifest->id);
  session.info = std::move(manifest).value();
  auto contents = ReadManifestContents(folder);
  if (!contents.ok())
    manifest_status = contents.status();
  else if (session.info.status != SessionStatus::kRecording)
    witnesses.manifest = std::move(contents).value();
  return Status::Ok();
}

void EndAsFailed(RebuiltSession& session, const Status& manifest) {
  if (session.told_by_index) {
    if (session.info.status == SessionStatus::kComplete) session.info.status = SessionStatus::kDegraded;
    session.info.reasons.emplace_back("its manifest was lost; what it said was taken from the index");
    session.problems.push_back(manifest.message() +
                               "; visitor, consent, plan and calibration were taken from the old index");
  } else if (!manifest.ok()) {
    session.info.status = SessionStatus::kFailed;
    session.info.reasons = {"its manifest was lost"};
    session.problems.push_back(manifest.message() + "; the session is listed as failed");
  }
  if (session.info.status != SessionStatus::kRecording) return;
  session.ended_here = true;
  session.info.status = SessionStatus::kFailed;
  session.info.reasons = {"the writer stopped before the session was finished; " +
                          std::to_string(session.frames.size()) + " whole frames kept"};
  session.info.finished_wall = WallNow();
  session.notes.push_back("session " + session.info.id + ": ended as failed: " + session.info.reasons[0]);
}

void SayLoss(RebuiltSession& session, const std::vector<std::string>& segments, const LossWitnesses& witnesses) {
  session.loss = FindLoss(session, segments, witnesses);
  for (const std::string& line : session.loss) {
    session.problems.push_back("session " + session.info.id + ": " + line);
    auto& reasons = session.info.reasons;
    if (std::find(reasons.begin(), reasons.end(), line) == reasons.end()) reasons.push_back(line);
  }
  if (!session.loss.empty() && session.info.status == SessionStatus::kComplete)
    session.info.status = SessionStatus::kDegraded;
}

}  // namespace

namespace {
// No store counts so far; a number beyond would leave none for the next session.
bool IsNumber(int64_t number) { return number >= 1 && number <= 1'000'000'000'000; }
}  // namespace

std::optional<int64_t> NumberOfId(const std::string& id) {
  const size_t dash = id.find('-');
  if (!id.starts_with('s') || dash == std::string::npos) return std::nullopt;
  int64_t number = 0;
  const auto parsed = std::from_chars(id.data() + 1, id.data() + dash, number);
  if (parsed.ec != std::errc() || parsed.ptr != id.data() + dash || !IsNumber(number)) return std::nullopt;
  return number;
}

Status WritePlace(const fs::path& folder, const SessionPlace& place) {
  const Json json = {{"schema", 1}, {"number", place.number}, {"from", place.from}};
  return ReplaceFile(folder / "place.json", json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n");
}

std::optional<int64_t> PlaceOf(const fs::path& folder) {
  const auto text = ReadFile(folder / "place.json");
  const Json json = text.ok() ? Json::parse(*text, nullptr, false) : Json();
  if (json.is_object() && json.contains("number") && json["number"].is_number_integer() &&
      IsNumber(json["number"].get<int64_t>()))
    return json["number"].get<int64_t>();
  return NumberOfId(folder.filename().string());
}

Result<RebuiltSession> RebuildSession(const fs::path& folder, const std::vector<KnownFrame>& known,
                                      const std::optional<SessionInfo>& listed) {
  RebuiltSession session;
  session.info.id = folder.filename().string();
  LossWitnesses witnesses;
  witnesses.known = known;
  Status manifest;
  SLX_RETURN_IF_ERROR(ReadInfo(folder, session, witnesses, manifest));
  if (!manifest.ok() && listed && listed->id == session.info.id) {
    session.info = *listed;
    session.told_by_index = true;
  }
  Rebuilder rebuilder(folder, session, witnesses);
  rebuilder.AddSegments();
  if (!manifest.ok() && session.frames.empty()) return manifest;
  EndAsFailed(session, manifest);
  AddFits(folder, session);
  SLX_RETURN_IF_ERROR(CheckSession(session));
  session.segments = rebuilder.segments();
  SayLoss(session, session.segments, witnesses);
  session.number = PlaceOf(folder);
  return session;
}

bool NeverBegan(const fs::path& folder, const Ledger& ledger) {
  std::error_code error;
  if (!fs::is_directory(folder, error) || fs::exists(fs::symlink_status(folder / "manifest.json", error))) return false;
  for (auto entry = fs::recursive_directory_iterator(folder, error);
       !error && entry != fs::recursive_directory_iterator(); entry.increment(error)) {
    if (entry->is_directory(error)) continue;
    const fs::path& file = entry->path();
    const bool header_at_most = file.extension() == ".seg" && entry->is_regular_file(error) &&
                                entry->file_size(error) <= static_cast<uintmax_t>(kSegmentStart);
    const std::string name = file.filename().string();
    if (!header_at_most && name != "manifest.json.new" && name != "place.json" && !IsSealedKeyName(name)) return false;
  }
  const std::string id = folder.filename().string();
  return !error && std::none_of(ledger.entries().begin(), ledger.entries().end(), [&id](const LedgerEntry& entry) {
    return std::find(entry.sessions.begin(), entry.sessions.end(), id) != entry.sessions.end();
  });
}

namespace {

Status SetEnding(Connection& connection, int64_t number, const RebuiltSession& session) {
  SLX_ASSIGN_OR_RETURN(auto update, connection.Prepare("UPDATE sessions SET finished_wall_ns = ?2, key_id = ?3"
                                                       " WHERE number = ?1"));
  update.Bind(1, number);
  if (session.info.finished_wall.ns != 0) update.Bind(2, session.info.finished_wall.ns);
  if (!session.frames.empty() && session.frames[0].second.header.cipher != 0)
    update.Bind(3, std::span<const uint8_t>(session.frames[0].second.header.key_id));
  return update.Run();
}

}  // namespace

Result<int64_t> InsertRebuilt(SessionIndex& index, const RebuiltSession& session, std::optional<int64_t> wanted) {
  Connection& connection = index.connection();
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
  SessionInfo info = session.info;
  if (!info.visitor.empty() && !info.consent.text_version.empty() && info.consent.given_wall.ns != 0)
    SLX_RETURN_IF_ERROR(InsertConsent(connection, info.visitor, info.consent, ConsentSource::kOfSession));
  SLX_ASSIGN_OR_RETURN(const int64_t number, index.InsertSession(info, wanted));
  SLX_RETURN_IF_ERROR(index.InsertFrames(number, session.frames));
  SLX_RETURN_IF_ERROR(index.WithdrawFrames(number, info.found.findings));
  SLX_RETURN_IF_ERROR(SetEnding(connection, number, session));
  for (const FitRow& fit : session.fits) SLX_RETURN_IF_ERROR(index.UpsertFit(number, fit));
  SLX_RETURN_IF_ERROR(transaction.Commit());
  return number;
}

}  // namespace stratalux::db
