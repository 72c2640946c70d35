// SPDX-License-Identifier: Apache-2.0
#include "db/verify.h"

#include <algorithm>
#include <filesystem>
#include <set>

#include "db/manifest.h"
#include "db/segment.h"
#include "db/transcode_journal.h"

namespace stratalux::db {
namespace {

void CheckSegment(const std::filesystem::path& file, const SessionRow& session, VerifyReport& report,
                  int64_t& stored_frames) {
  const auto reader = SegmentReader::Open(file);
  if (!reader.ok()) return report.problems.push_back(reader.status().message());
  if (reader->session_id() != session.info.id)
    report.problems.push_back(file.string() + " belongs to session " + reader->session_id());
  bool sealed = false;
  const auto frames = reader->Walk(true, &sealed);
  if (!frames.ok()) {
    // A live writer's last record may be half written: its rows say what counts.
    const bool live = session.info.status == SessionStatus::kRecording;
    return (live ? report.notes : report.problems).push_back(frames.status().message());
  }
  if (file.filename() != "truth.seg") stored_frames += static_cast<int64_t>(frames->size());
  for (const SegmentFrame& f : *frames) {
    ++report.frames;
    report.bytes += static_cast<int64_t>(f.header.payload_bytes);
  }
  if (sealed) return;
  const std::string text = file.filename().string() + " has no footer";
  if (session.info.status == SessionStatus::kFailed || session.info.status == SessionStatus::kRecording) {
    report.notes.push_back(text + " (the session was not finished)");
  } else {
    report.problems.push_back(file.string() + ": truncated: a finished session's segment must end with a footer");
  }
}

void CheckPlan(const SessionRow& session, const std::vector<FrameRow>& frames, VerifyReport& report) {
  if (session.info.plan_json.empty() || session.info.status == SessionStatus::kFailed) return;
  const auto options = PlanOptionsFromJson(session.info.plan_json);
  if (!options.ok()) return report.problems.push_back(options.status().message());
  const auto plan = BuildPlan(*options);
  if (!plan.ok()) return report.problems.push_back(plan.status().message());
  std::set<int> good;
  for (const FrameRow& f : frames)
    if (f.record.level_check != LevelCheck::kFailed) good.insert(f.record.step);
  for (const PlanStep& step : plan->steps) {
    if (good.contains(step.index)) continue;
    const std::string text =
        "step " + std::to_string(step.index) + " (" + step.pattern.ToString() + ") has no good frame";
    (session.info.status == SessionStatus::kComplete ? report.problems : report.notes).push_back(text);
  }
}

// Segments of a transcode under way or interrupted that the index does not name (or names no longer).
void SetAsideTranscoded(const SessionStore& store, const SessionRow& session, const std::vector<FrameRow>& frames,
                        std::vector<std::filesystem::path>& segments, VerifyReport& report) {
  const auto journal = ReadTranscodeJournal(store.folder());
  if (!journal.ok()) return report.problems.push_back(journal.status().message());
  if (!*journal || (*journal)->session != session.info.id) return;
  std::set<std::string> indexed = {"truth.seg"};
  for (const FrameRow& f : frames) indexed.insert(f.segment);
  std::erase_if(segments, [&](const std::filesystem::path& file) {
    const bool left = !indexed.contains(file.filename().string());
    if (left)
      report.notes.push_back(file.filename().string() +
                             " belongs to an unfinished transcode; the next command that writes the store settles it");
    return left;
  });
}

}  // namespace

Result<VerifyReport> VerifySession(const SessionStore& store, const SessionRow& session) {
  VerifyReport report;
  const auto folder = store.SessionFolder(session.info.id);
  std::vector<std::filesystem::path> segments;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error))
    if (entry.path().extension() == ".seg") segments.push_back(entry.path());
  if (error) report.problems.push_back(folder.string() + ": " + error.message());
  std::sort(segments.begin(), segments.end());
  int64_t stored_frames = 0;
  const auto frames = store.ListFrames(session.info.id);
  if (frames.ok()) SetAsideTranscoded(store, session, *frames, segments, report);
  for (const auto& file : segments) CheckSegment(file, session, report, stored_frames);
  if (!frames.ok()) {
    report.problems.push_back(frames.status().message());
  } else {
    CheckPlan(session, *frames, report);
    const auto indexed = static_cast<int64_t>(frames->size());
    if (stored_frames != indexed && report.problems.empty() && session.info.status != SessionStatus::kRecording)
      report.problems.push_back(folder.string() + ": segments hold " + std::to_string(stored_frames) +
                                " frames, the index " + std::to_string(indexed));
  }
  if (session.info.status == SessionStatus::kComplete || session.info.status == SessionStatus::kDegraded) {
    const auto manifest = ReadManifest(folder);
    if (!manifest.ok()) {
      report.problems.push_back(manifest.status().message());
    } else if (manifest->id != session.info.id) {
      report.problems.push_back(folder.string() + "/manifest.json names session " + manifest->id);
    }
  }
  return report;
}

}  // namespace stratalux::db
