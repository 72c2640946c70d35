// SPDX-License-Identifier: Apache-2.0
#include "db/care/session_rebuild.h"

#include <algorithm>
#include <charconv>
#include <map>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/catalogue/calibration_store.h"
#include "db/catalogue/consent_rows.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/manifest.h"
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
  return parsed.ec == std::errc() && parsed.ptr == end ? std::optional(number) : std::nullopt;
}

// Where a footer is missing or damaged: frame by frame. A damaged payload in the middle keeps its row, so that `verify`
// names it; behind the last whole frame nothing counts.
std::vector<SegmentFrame> WalkWhole(const SegmentReader& reader, int64_t& end) {
  std::vector<SegmentFrame> frames;
  std::vector<uint8_t> buffer;
  size_t whole = 0;
  int64_t offset = end = kSegmentStart;
  while (offset < reader.size()) {
    const auto header = reader.ReadHeader(offset);
    if (!header.ok() || header->payload_bytes > static_cast<uint64_t>(reader.size())) break;
    const int64_t next = offset + static_cast<int64_t>(sizeof(FrameHeader) + header->payload_bytes);
    if (next > reader.size()) break;
    frames.push_back({*header, offset});
    if (reader.ReadPayload(offset, *header, buffer).ok()) {
      whole = frames.size();
      end = next;
    }
    offset = next;
  }
  frames.resize(whole);
  return frames;
}

void AddSegment(const fs::path& file, int64_t number, RebuiltSession& session) {
  const auto reader = SegmentReader::Open(file);
  if (!reader.ok()) return session.notes.push_back(reader.status().message());
  if (reader->session_id() != session.info.id)
    return session.notes.push_back(file.string() + " belongs to session " + reader->session_id() + "; left out");
  auto frames = reader->Footer();
  if (!frames) {
    int64_t end = 0;
    frames = WalkWhole(*reader, end);
    if (end < reader->size()) {
      session.tails.push_back({file, end});
      session.notes.push_back(file.string() + ": no intact footer, " + std::to_string(frames->size()) +
                              " whole frames up to byte " + std::to_string(end) + " of " +
                              std::to_string(reader->size()));
    }
  }
  for (const SegmentFrame& frame : *frames) session.frames.emplace_back(number, frame);
}

// Frame numbers count from 0 without a gap and only once; a damaged segment in the middle leaves one.
void CheckNumbers(RebuiltSession& session) {
  auto frame_of = [](const auto& f) { return f.second.header.frame; };
  std::stable_sort(session.frames.begin(), session.frames.end(),
                   [&](const auto& a, const auto& b) { return frame_of(a) < frame_of(b); });
  const auto twice = std::unique(session.frames.begin(), session.frames.end(),
                                 [&](const auto& a, const auto& b) { return frame_of(a) == frame_of(b); });
  if (twice != session.frames.end())
    session.notes.push_back("session " + session.info.id + ": " + std::to_string(session.frames.end() - twice) +
                            " frames are there twice; the first of each was taken");
  session.frames.erase(twice, session.frames.end());
  for (size_t i = 0; i < session.frames.size(); ++i)
    if (frame_of(session.frames[i]) != static_cast<int64_t>(i))
      return session.notes.push_back("session " + session.info.id + ": frame " + std::to_string(i) + " is missing");
}

void AddFits(const fs::path& folder, RebuiltSession& session) {
  for (const fs::path& fit : Sorted(folder / "fits")) {
    if (fit.extension() == ".partial") continue;
    auto record = ReadFitRecord(fit, session.info.id);
    if (record.ok()) {
      auto calibration = ReadFitCalibration(fit);
      if (!calibration.ok()) session.notes.push_back(calibration.status().message());
      if (calibration.ok()) record->calibration_json = calibration->value_or("");
      session.fits.push_back(std::move(record).value());
    } else if (record.status().code() != StatusCode::kNotFound) {
      session.notes.push_back(record.status().message());
    }
  }
}

}  // namespace

std::optional<int64_t> NumberOfId(const std::string& id) {
  const size_t dash = id.find('-');
  if (!id.starts_with('s') || dash == std::string::npos) return std::nullopt;
  int64_t number = 0;
  const auto parsed = std::from_chars(id.data() + 1, id.data() + dash, number);
  if (parsed.ec != std::errc() || parsed.ptr != id.data() + dash || number < 1) return std::nullopt;
  return number;
}

Status WritePlace(const fs::path& folder, const SessionPlace& place) {
  const Json json = {{"schema", 1}, {"number", place.number}, {"from", place.from}};
  return ReplaceFile(folder / "place.json", json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n");
}

std::optional<int64_t> PlaceOf(const fs::path& folder) {
  const auto text = ReadFile(folder / "place.json");
  const Json json = text.ok() ? Json::parse(*text, nullptr, false) : Json();
  if (json.is_object() && json.contains("number") && json["number"].is_number_integer())
    return json["number"].get<int64_t>();
  return NumberOfId(folder.filename().string());
}

Result<RebuiltSession> RebuildSession(const fs::path& folder) {
  RebuiltSession session;
  const std::string id = folder.filename().string();
  auto manifest = ReadManifest(folder);
  if (manifest.status().code() == StatusCode::kNewerSchema) return manifest.status();
  if (manifest.ok() && manifest->id != id)
    return Status::Integrity((folder / "manifest.json").string() + " is of session " + manifest->id);
  if (manifest.ok()) session.info = std::move(manifest).value();
  session.info.id = id;
  for (const fs::path& file : Sorted(folder))
    if (const auto number = SegmentNumber(file)) AddSegment(file, *number, session);
  CheckNumbers(session);
  if (!manifest.ok()) {
    if (session.frames.empty()) return manifest.status();
    session.info.status = SessionStatus::kFailed;
    session.info.reasons = {"its manifest was lost: " + manifest.status().message()};
    session.notes.push_back(manifest.status().message() + "; the session is listed as failed");
  }
  if (session.info.status == SessionStatus::kRecording) {
    session.info.status = SessionStatus::kFailed;
    session.info.reasons = {"the writer stopped before the session was finished; " +
                            std::to_string(session.frames.size()) + " whole frames kept"};
    session.info.finished_wall = WallNow();
    session.notes.push_back("session " + id + ": ended as failed: " + session.info.reasons[0]);
  }
  if (session.info.status != SessionStatus::kFailed) session.tails.clear();  // damage, not a writer's tail: left to see
  AddFits(folder, session);
  session.number = PlaceOf(folder);
  return session;
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
  SLX_RETURN_IF_ERROR(SetEnding(connection, number, session));
  for (const FitRow& fit : session.fits) SLX_RETURN_IF_ERROR(index.UpsertFit(number, fit));
  SLX_RETURN_IF_ERROR(transaction.Commit());
  return number;
}

}  // namespace stratalux::db
