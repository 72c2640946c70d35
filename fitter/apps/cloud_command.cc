// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit cloud`: points from codes and a calibration alone, of visitors, boards and imported captures alike.
#include <algorithm>
#include <filesystem>
#include <memory>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "db/catalogue/fit_reader.h"
#include "db/privacy/export_marker.h"
#include "fitter/apps/run_command.h"
#include "fitter/export/ply_file.h"
#include "fitter/session/choose_session.h"
#include "fitter/stages/cloud.h"
#include "fitter/stages/decode.h"
#include "shared/base/read_file.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

struct CloudFlags {
  std::string store, session = "latest", calibration, out;
  int pose = -1;
  bool json = false;
};

// --calibration, else what the session was captured with. Frames that carry a record are read by the one that counts;
// what an import's levels mean, its bit depth says.
Result<RigCalibration> RecordFor(const CloudFlags& f, SessionFrames& frames) {
  if (f.calibration.empty()) {
    if (frames.record()) return *frames.record();
    return Status::Usage("session " + frames.info().id +
                         " carries no calibration: name a record with --calibration (`stratalux-fit calibrate --out` "
                         "writes one)");
  }
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(f.calibration));
  SLX_ASSIGN_OR_RETURN(auto record, RigCalibration::FromJson(text).WithContext("--calibration " + f.calibration));
  if (frames.record()) frames.UseRecord(record);
  return record;
}

Result<std::vector<int>> PosesOf(const CloudFlags& f, const SessionFrames& frames) {
  std::vector<int> poses = CodedPoses(frames);
  if (poses.empty()) return Status::NotFound("session " + frames.info().id + " has no codes");
  if (f.pose < 0) return poses;
  if (std::ranges::find(poses, f.pose) == poses.end())
    return Status::NotFound("session " + frames.info().id + " has no codes of pose " + std::to_string(f.pose));
  return std::vector<int>{f.pose};
}

std::string FileOf(int pose) { return pose >= 0 ? "cloud_pose" + std::to_string(pose) + ".ply" : "cloud.ply"; }

nlohmann::ordered_json JsonOf(const DriftReport& drift) {
  auto projectors = nlohmann::ordered_json::array();
  for (const ProjectorDrift& d : drift.projectors)
    projectors.push_back({{"projector", d.projector},
                          {"points", d.points},
                          {"judged", d.judged()},
                          {"shift_px", d.shift_px},
                          {"turned_deg", d.turned_deg},
                          {"moved", d.moved}});
  return {{"warning", drift.warning}, {"projectors", projectors}};
}

std::string MotionText(const CodedCloud& made) {
  return made.motion_unasked.empty() ? Describe(made.motion)
                                     : "motion of the head: not looked for (" + made.motion_unasked + ")";
}

nlohmann::ordered_json MotionJson(const CodedCloud& made) {
  const HeadMotion& head = made.motion.head;
  return {{"known", !head.poses.empty()},
          {"moved", head.moved},
          {"largest_mm", head.largest_mm},
          {"sigma_mm", head.sigma_mm},
          {"text", MotionText(made)}};
}

nlohmann::ordered_json JsonOf(int pose, const CodedCloud& made) {
  const TriangulationCounts& c = made.counts;
  return {{"pose", pose},
          {"file", FileOf(pose)},
          {"projectors", made.projectors},
          {"points", made.cloud.positions_mm.size()},
          {"pixels",
           {{"triangulated", c.sites},
            {"undecoded", c.undecoded},
            {"contradicting", c.inconsistent},
            {"uncertain", c.uncertain}}},
          {"quads_left_out",
           {{"lone", c.lone}, {"mixed", c.mixed}, {"islands", c.islands}, {"unsmoothed", made.unsmoothed}}},
          {"motion", MotionJson(made)},
          {"drift", JsonOf(made.drift)}};
}

std::string TextOf(const CodedCloud& made) {
  return std::to_string(made.cloud.positions_mm.size()) + " points of " + std::to_string(made.counts.sites) +
         " triangulated pixels; " + std::to_string(made.counts.inconsistent) + " contradict the calibration, " +
         std::to_string(made.counts.uncertain) + " are too uncertain";
}

Status Cloud(const CloudFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(f.store, f.session, SessionUse::kFrames, logger));
  SLX_ASSIGN_OR_RETURN(auto frames, SessionFrames::Open(f.store, chosen));
  for (const std::string& note : frames.store().notes()) logger.Warning(note);
  const std::string session = frames.info().id;
  SLX_ASSIGN_OR_RETURN(const RigCalibration record, RecordFor(f, frames));
  SLX_ASSIGN_OR_RETURN(const std::vector<int> poses, PosesOf(f, frames));
  SLX_ASSIGN_OR_RETURN(const auto seal, db::FindSeal(frames.store(), session));
  std::vector<std::string> files;
  for (const int pose : poses) files.push_back(FileOf(pose));
  std::vector<CodedCloud> clouds;  // all of them before any is written: one that cannot be made leaves no others
  for (const int pose : poses) {
    SLX_ASSIGN_OR_RETURN(auto made, CloudFromCodes(frames, pose, record));
    for (const int projector : made.projectors)
      if (const std::string note = UnreadPatterns(frames, projector, pose); !note.empty()) logger.Warning(note);
    clouds.push_back(std::move(made));
  }
  auto results = nlohmann::ordered_json::array();
  std::string text;
  const auto write = [&]() -> Status {
    for (size_t k = 0; k < poses.size(); ++k) {
      const int pose = poses[k];
      const CodedCloud& made = clouds[k];
      const std::filesystem::path file = std::filesystem::path(f.out) / FileOf(pose);
      SLX_RETURN_IF_ERROR(db::WriteExportedFile(file, [&](const std::filesystem::path& beside) {
        return WritePly(beside, made.cloud, {.session = session});
      }));
      logger.Info(FileOf(pose) + ": " + TextOf(made));
      logger.Info(FileOf(pose) + ": " + MotionText(made));
      if (!made.drift.warning.empty()) logger.Warning(FileOf(pose) + ": " + made.drift.warning);
      results.push_back(JsonOf(pose, made));
      text += file.string() + "\n";
    }
    return Status::Ok();
  };
  SLX_RETURN_IF_ERROR(db::WriteExport(f.store, "cloud", session, f.out, files, write));
  if (seal.active()) logger.Info(PlainCopyNote(session, f.out));
  if (!f.json) return WriteStdout(text);
  const nlohmann::ordered_json all = {{"session", session}, {"folder", f.out}, {"clouds", results}};
  return WriteStdout(all.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
}

}  // namespace

void AddCloudCommand(CLI::App& app, int& exit_code) {
  auto flags = std::make_shared<CloudFlags>();
  auto* verb = app.add_subcommand(
      "cloud", "Points with covariance from codes and a calibration alone; works on imported captures too");
  verb->footer(
      "Decodes, triangulates and smooths; needs only Gray codes, white and black: no sweeps, no fit.\n"
      "`stratalux-db import` brings images from folders into a store. cloud.ply (for board poses: cloud_poseN.ply) "
      "is in\n"
      "the camera frame, mm: +x right, +y down, +z away from the camera; like that of `export`, but without colour.\n"
      "Examples:\n"
      "  stratalux-fit cloud latest --store store --out points\n"
      "  stratalux-fit cloud s000002 --store store --calibration rig.json --pose 3 --out points --json");
  verb->add_option("session", flags->session, "Session: id, unique prefix, or latest")->capture_default_str();
  verb->add_option("--store", flags->store, "Store folder")->envname("STRATALUX_STORE")->required();
  verb->add_option("--calibration", flags->calibration,
                   "Record (JSON) of the rig, as `calibrate --out` writes it (default: the session's own)");
  verb->add_option("--pose", flags->pose, "Only this board pose")->check(CLI::Range(0, 10000));
  verb->add_option("--out", flags->out, "Folder for the clouds, unencrypted; logged, so that `forget` finds it")
      ->required();
  verb->add_flag("--json", flags->json, "Machine-readable result on stdout");
  verb->callback([flags, &exit_code] {
    Logger logger;
    const Status status = Cloud(*flags, logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
}

}  // namespace stratalux::fit
