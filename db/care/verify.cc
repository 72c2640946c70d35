// SPDX-License-Identifier: Apache-2.0
#include "db/care/verify.h"

#include <algorithm>
#include <filesystem>
#include <set>

#include "db/care/complementary_pairs.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/transcode_journal.h"
#include "db/segment/segment.h"
#include "shared/base/parallel.h"

namespace stratalux::db {
namespace {

// Hashes every payload; each thread reads frames of its own into a buffer of its own.
void CheckPayloads(const SegmentReader& reader, const std::vector<SegmentFrame>& frames, VerifyReport& report) {
  std::vector<Status> results(frames.size());
  ParallelFor(static_cast<int64_t>(frames.size()), 8, [&](int64_t begin, int64_t end) {
    std::vector<uint8_t> buffer;
    for (auto i = static_cast<size_t>(begin); i < static_cast<size_t>(end); ++i)
      results[i] = reader.ReadPayload(frames[i].offset, frames[i].header, buffer);
  });
  for (const Status& result : results)
    if (!result.ok()) report.problems.push_back(result.message());
}

void CheckSegment(const std::filesystem::path& file, const SessionRow& session, const VerifyOptions& options,
                  VerifyReport& report, int64_t& stored_frames) {
  const auto reader = SegmentReader::Open(file);
  if (!reader.ok()) return report.problems.push_back(reader.status().message());
  if (reader->session_id() != session.info.id)
    report.problems.push_back(file.string() + " belongs to session " + reader->session_id());
  bool sealed = false;
  const auto frames = reader->Walk(false, &sealed);
  if (!frames.ok()) {
    // A live writer's last record may be half written: its rows say what counts.
    const bool live = session.info.status == SessionStatus::kRecording;
    return (live ? report.notes : report.problems).push_back(frames.status().message());
  }
  if (options.depth == VerifyDepth::kDeep) CheckPayloads(*reader, *frames, report);
  if (options.progress != nullptr && file.filename() != "truth.seg")
    options.progress->Advance(static_cast<int64_t>(frames->size()));
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

// Frames lie in the order of their triggers and of the driver's numbers. (Neither need be without gaps: the bank's
// number counts projector pulses too, and what was spoilt or came unasked was not kept.)
void CheckProofs(const SessionRow& session, const std::vector<FrameRow>& frames, VerifyReport& report) {
  auto& disorder = session.info.status == SessionStatus::kComplete ? report.problems : report.notes;
  int64_t not_kept = 0;
  for (size_t i = 1; i < frames.size(); ++i) {
    const FrameRecord &before = frames[i - 1].record, &now = frames[i].record;
    if (before.trigger_number < 0 || now.trigger_number < 0) continue;  // imports
    const std::string where = "frame " + std::to_string(frames[i].id) + " (step " + std::to_string(now.step) + "): ";
    auto numbers = [](int64_t a, int64_t b) { return std::to_string(b) + " follows " + std::to_string(a); };
    if (now.trigger_number <= before.trigger_number)
      disorder.push_back(where + "trigger " + numbers(before.trigger_number, now.trigger_number));
    if (now.driver_sequence < 0) continue;
    if (now.driver_sequence <= before.driver_sequence)
      disorder.push_back(where + "driver sequence " + numbers(before.driver_sequence, now.driver_sequence));
    else if (before.driver_sequence >= 0)
      not_kept += now.driver_sequence - before.driver_sequence - 1;
  }
  if (not_kept > 0)
    report.notes.push_back("the driver counted " + std::to_string(not_kept) +
                           " frames that were not kept: lost, spoilt or not asked for");
}

void CheckPairs(const SessionStore& store, const SessionRow& session, const std::vector<FrameRow>& frames,
                VerifyReport& report) {
  const auto complaints =
      CheckComplementaryPairs(frames, [&](const FrameRow& frame) { return store.ReadFrame(session.info.id, frame); });
  auto& list = session.info.status == SessionStatus::kComplete ? report.problems : report.notes;
  list.insert(list.end(), complaints.begin(), complaints.end());
}

// Segments that the manifest does not name, and files of nobody.
void CheckNames(const std::filesystem::path& folder, const std::vector<std::string>& segments, VerifyReport& report) {
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with("frames-") && name.ends_with(".seg")) {
      if (std::find(segments.begin(), segments.end(), name) == segments.end())
        report.problems.push_back(entry.path().string() + " is not named by the manifest");
    } else if (name != "manifest.json" && name != "truth.seg" && name != "truth_calibration.json" &&
               name != "place.json" && name != "fits" && name != "previews") {
      report.notes.push_back(entry.path().string() + " is no file of a session");
    }
  }
}

void CheckManifest(const std::filesystem::path& folder, const SessionRow& session, VerifyReport& report) {
  const auto manifest = ReadManifest(folder);
  if (!manifest.ok()) return report.problems.push_back(manifest.status().message());
  const auto contents = ReadManifestContents(folder);
  if (!contents.ok()) return report.problems.push_back(contents.status().message());
  const std::string file = (folder / "manifest.json").string();
  if (manifest->id != session.info.id) report.problems.push_back(file + " names session " + manifest->id);
  if (manifest->status != session.info.status)
    report.problems.push_back(file + " says '" + ToString(manifest->status) + "', the index '" +
                              ToString(session.info.status) + "'");
  if (contents->frames != session.frames)
    report.problems.push_back(file + " speaks of " + std::to_string(contents->frames) + " frames, the index of " +
                              std::to_string(session.frames));
  for (const std::string& name : contents->segments) {
    const bool inside = !name.empty() && name.find('/') == std::string::npos;
    if (std::error_code error; !inside || !std::filesystem::exists(folder / name, error))
      report.problems.push_back(file + " names " + name + ", which is not there");
  }
  CheckNames(folder, contents->segments, report);
}

// Segments of a transcode under way or interrupted that the index does not name (or names no longer).
// True where there is such a transcode.
bool SetAsideTranscoded(const SessionStore& store, const SessionRow& session, const std::vector<FrameRow>& frames,
                        std::vector<std::filesystem::path>& segments, VerifyReport& report) {
  const auto journal = ReadTranscodeJournal(store.folder());
  if (!journal.ok()) report.problems.push_back(journal.status().message());
  if (!journal.ok() || !*journal || (*journal)->session != session.info.id) return false;
  std::set<std::string> indexed = {"truth.seg"};
  for (const FrameRow& f : frames) indexed.insert(f.segment);
  std::erase_if(segments, [&](const std::filesystem::path& file) {
    const bool left = !indexed.contains(file.filename().string());
    if (left)
      report.notes.push_back(file.filename().string() +
                             " belongs to an unfinished transcode; the next command that writes the store settles it");
    return left;
  });
  return true;
}

}  // namespace

Result<VerifyReport> VerifySession(const SessionStore& store, const SessionRow& session, const VerifyOptions& options) {
  VerifyReport report;
  const auto folder = store.SessionFolder(session.info.id);
  std::vector<std::filesystem::path> segments;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error))
    if (entry.path().extension() == ".seg") segments.push_back(entry.path());
  // A session whose folder could not be made has failed and has no frames: nothing is missing.
  const bool never_began = session.info.status == SessionStatus::kFailed && session.frames == 0;
  if (error) (never_began ? report.notes : report.problems).push_back(folder.string() + ": " + error.message());
  std::sort(segments.begin(), segments.end());
  int64_t stored_frames = 0;
  const auto frames = store.ListFrames(session.info.id);
  const bool transcoding = frames.ok() && SetAsideTranscoded(store, session, *frames, segments, report);
  for (const auto& file : segments) CheckSegment(file, session, options, report, stored_frames);
  if (!frames.ok()) {
    report.problems.push_back(frames.status().message());
  } else {
    CheckPlan(session, *frames, report);
    CheckProofs(session, *frames, report);
    if (options.depth == VerifyDepth::kDeep) CheckPairs(store, session, *frames, report);
    const auto indexed = static_cast<int64_t>(frames->size());
    if (stored_frames != indexed && report.problems.empty() && session.info.status != SessionStatus::kRecording)
      report.problems.push_back(folder.string() + ": segments hold " + std::to_string(stored_frames) +
                                " frames, the index " + std::to_string(indexed));
  }
  // While segments are being replaced, the manifest names the old ones.
  if (!transcoding &&
      (session.info.status == SessionStatus::kComplete || session.info.status == SessionStatus::kDegraded))
    CheckManifest(folder, session, report);
  return report;
}

}  // namespace stratalux::db
