// SPDX-License-Identifier: Apache-2.0
#include "db/care/verify.h"

#include <algorithm>
#include <filesystem>
#include <set>

#include "db/care/complementary_pairs.h"
#include "db/care/row_comparison.h"
#include "db/care/session_loss.h"
#include "db/care/session_rebuild.h"
#include "db/care/verify_payloads.h"
#include "db/care/verify_seals.h"
#include "db/catalogue/artifact_record.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/signature.h"
#include "db/catalogue/transcode_journal.h"
#include "db/keys/sealed_key.h"
#include "db/segment/segment.h"
#include "db/segment/segment_scan.h"

namespace stratalux::db {
namespace {

// The frames of a segment whose writer was stopped in the middle of a record, which nobody cuts; nullopt where the file
// is damaged otherwise.
std::optional<std::vector<SegmentFrame>> FramesBeforeOpenTail(const SegmentReader& reader, VerifyReport& report) {
  SegmentScan scan = ScanSegment(reader, {});
  if (!scan.findings.empty() || !scan.lost.empty() || scan.asides.size() != 1 || scan.asides[0].end != reader.size())
    return std::nullopt;
  report.notes.push_back(reader.file() + ": bytes " + std::to_string(scan.asides[0].begin) + " to " +
                         std::to_string(scan.asides[0].end) + " hold a record that was never finished");
  return std::move(scan.frames);
}

void CheckSegment(const SessionStore& store, const std::filesystem::path& file, const SessionRow& session,
                  const VerifyOptions& options, VerifyReport& report, int64_t& stored_frames) {
  const auto reader = SegmentReader::Open(file);
  if (!reader.ok()) return report.problems.push_back(reader.status().message());
  if (reader->session_id() != session.info.id)
    report.problems.push_back(file.string() + " belongs to session " + reader->session_id());
  bool sealed = false;
  auto frames = reader->Walk(false, &sealed);
  if (!frames.ok() && session.info.status == SessionStatus::kFailed)
    if (auto whole = FramesBeforeOpenTail(*reader, report)) frames = *std::move(whole);
  if (!frames.ok()) {
    // A live writer's last record may be half written: its rows say what counts.
    const bool live = session.info.status == SessionStatus::kRecording;
    return (live ? report.notes : report.problems).push_back(frames.status().message());
  }
  if (options.depth == VerifyDepth::kDeep) CheckPayloads(store.folder(), *reader, *frames, report);
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
  const std::vector<NumberRange> lacking = LackingSteps(*plan, good);
  if (lacking.empty()) return;
  (session.info.status == SessionStatus::kComplete ? report.problems : report.notes)
      .push_back(std::to_string(CountOf(lacking)) + " of " + std::to_string(plan->steps.size()) +
                 " planned steps without a good frame: " + ToText(lacking));
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
                           " frames that were not kept: lost, spoilt or not requested");
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
               name != "place.json" && name != "signature.json" && name != kDamagedManifest && name != "fits" &&
               name != "previews" && name != kArtifactsFolder && !IsSealedKeyName(name)) {
      report.notes.push_back(entry.path().string() + " is not a file of a session");
    }
  }
}

// What the manifest says of each file, against the file. Segments of failed sessions may have no footer.
void CheckFiles(const std::filesystem::path& folder, const ManifestContents& contents, VerifyReport& report) {
  if (contents.schema < 3) return;
  const std::string manifest = (folder / "manifest.json").string();
  std::set<std::string> listed;
  for (const auto& file : contents.files) {
    listed.insert(file.name);
    if (file.name.find('/') != std::string::npos) {
      report.problems.push_back(manifest + " names '" + file.name + "', which is not a file of its folder");
      continue;
    }
    const auto there = DescribeFile(folder, file.name);
    if (!there.ok())
      report.problems.push_back(there.status().message());
    else if (there->bytes != file.bytes || there->hash != file.hash)
      report.problems.push_back((folder / file.name).string() + " is not the file that the manifest describes (" +
                                std::to_string(there->bytes) + " bytes, " + std::to_string(file.bytes) +
                                " in the manifest)");
  }
  std::set<std::string> wanted(contents.segments.begin(), contents.segments.end());
  std::error_code error;
  for (const char* name : {"truth.seg", "truth_calibration.json"})
    if (std::filesystem::exists(folder / name, error)) wanted.insert(name);
  for (const std::string& name : wanted)
    if (!listed.contains(name)) report.problems.push_back(manifest + " does not say what " + name + " holds");
}

void CheckManifest(const std::filesystem::path& folder, const SessionRow& session, VerifyReport& report) {
  const auto manifest = ReadManifest(folder);
  if (manifest.ok() && manifest->status == SessionStatus::kRecording && session.info.status == SessionStatus::kFailed) {
    // Its disk was full; CompareSession looks at what the index says of it.
    return report.notes.push_back((folder / "manifest.json").string() +
                                  " still describes a session that is being recorded");
  }
  if (!manifest.ok()) return report.problems.push_back(manifest.status().message());
  const auto contents = ReadManifestContents(folder);
  if (!contents.ok()) return report.problems.push_back(contents.status().message());
  const std::string file = (folder / "manifest.json").string();
  if (manifest->id != session.info.id) report.problems.push_back(file + " names session " + manifest->id);
  if (manifest->status != session.info.status)
    report.problems.push_back(file + " says '" + ToString(manifest->status) + "', the index '" +
                              ToString(session.info.status) + "'");
  if (contents->frames != session.frames)
    report.problems.push_back(file + " lists " + std::to_string(contents->frames) + " frames, the index lists " +
                              std::to_string(session.frames));
  for (const std::string& name : contents->segments) {
    const bool inside = !name.empty() && name.find('/') == std::string::npos;
    if (std::error_code error; !inside || !std::filesystem::exists(folder / name, error))
      report.problems.push_back(file + " names " + name + ", which is not there");
  }
  CheckNames(folder, contents->segments, report);
  CheckFiles(folder, *contents, report);
}

// Each file of the fits that are listed, against what their fit.json says of it.
void CheckFits(const SessionStore& store, const SessionRow& session, VerifyReport& report) {
  const auto fits = store.ListFits(session.info.id);
  if (!fits.ok()) return report.problems.push_back(fits.status().message());
  for (const FitRow& fit : *fits) {
    const auto folder = store.FitFolder(session.info.id, fit.id);
    std::error_code error;
    if (!std::filesystem::exists(folder / kFitRecordFile, error)) continue;  // of an older program, or gone: its row
    if (const Status whole = CheckFitFiles(folder); !whole.ok()) report.problems.push_back(whole.message());
  }
}

// Artifacts are nobody's only copy: a fit has its own names for the files it is made of.
void CheckArtifacts(const std::filesystem::path& folder, VerifyReport& report) {
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder / kArtifactsFolder, error)) {
    // Locks, and what a fit is making now or was making when it was killed.
    if (entry.path().filename().string().starts_with(".")) continue;
    const auto record = ReadArtifactRecord(entry.path());
    const Status whole = record.ok() ? CheckArtifactFiles(entry.path(), *record, FileDepth::kHashes) : record.status();
    if (!whole.ok())
      report.problems.push_back(whole.message() + " (`stratalux-fit clean --damaged` removes it; it is made again)");
  }
}

void CheckSigner(const std::filesystem::path& folder, const SessionRow& session, const VerifyOptions& options,
                 VerifyReport& report) {
  const auto depth = options.depth == VerifyDepth::kDeep ? SignatureDepth::kPixels : SignatureDepth::kHeaders;
  const SignatureReport found = CheckSignature(folder, depth);
  report.problems.insert(report.problems.end(), found.problems.begin(), found.problems.end());
  if (found.signed_by && found.problems.empty()) report.signed_by = found.signed_by;
  if (!options.signed_by || found.signed_by == options.signed_by) return;
  report.problems.push_back("session " + session.info.id +
                            (found.signed_by ? " is signed with another key, " + Fingerprint(*found.signed_by)
                                             : std::string(" is not signed")) +
                            ": key " + Fingerprint(*options.signed_by) + " was required");
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
  for (const auto& file : segments) CheckSegment(store, file, session, options, report, stored_frames);
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
  if (error && never_began) return report;
  // While segments are being replaced, manifest and rows may speak of the old ones and of the new.
  if (transcoding) return report;
  // A disk that was full from the first byte on: the row is all there is.
  if (never_began && !std::filesystem::exists(folder / "manifest.json", error)) {
    report.notes.push_back(folder.string() + " has no manifest: the session failed before its first frame");
    return report;
  }
  const bool recording = session.info.status == SessionStatus::kRecording;
  if (!recording) CheckManifest(folder, session, report);
  for (std::string& line : CompareSession(store.folder(), session, report.notes))
    report.problems.push_back(std::move(line));
  CheckSeals(store, session, options.depth, report);
  CheckSealedKeys(store, session, report);
  if (options.depth == VerifyDepth::kDeep) {
    CheckFits(store, session, report);
    CheckArtifacts(folder, report);
  }
  if (!recording) CheckSigner(folder, session, options, report);
  return report;
}

}  // namespace stratalux::db
