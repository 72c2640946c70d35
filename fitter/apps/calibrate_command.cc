// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit calibrate`: board poses, dark, flat and response sessions -> a calibration record, judged.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <set>
#include <sstream>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "fitter/apps/run_command.h"
#include "fitter/calibration/board_stage.h"
#include "fitter/calibration/calibration_record.h"
#include "fitter/calibration/light_record.h"
#include "fitter/calibration/light_stage.h"
#include "fitter/report/calibration_page.h"
#include "fitter/session/choose_session.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/read_file.h"
#include "shared/base/standard_output.h"
#include "shared/base/version.h"

namespace stratalux::fit {
namespace {

struct CalibrateFlags {
  std::string store, out, board = "charuco", squares = "10x7", distortion = "auto";
  std::string camera_size, projector_size, known_camera, known_rig, page;
  std::vector<std::string> sessions;
  BoardStageOptions stage;
  LightStageOptions light;
  int last = 0;
  std::optional<double> valid_days;
  bool json = false;
};

Status ParseSize(const std::string& flag, const std::string& text, int& width, int& height) {
  std::istringstream in(text);
  char x = 0;
  if (in >> width >> x >> height && x == 'x' && width > 0 && height > 0 && in.peek() == EOF) return Status::Ok();
  return Status::Usage(flag + " '" + text + "': expected WIDTHxHEIGHT");
}

Result<RigCalibration> ReadRecord(const std::string& flag, const std::string& file) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  return RigCalibration::FromJson(text).WithContext(flag + " " + file);
}

Result<CalibrateOptions> OptionsFrom(CalibrateFlags& f) {
  CalibrateOptions options;
  SLX_ASSIGN_OR_RETURN(f.stage.board.kind, ParseBoardKind(f.board).WithContext("--board"));
  SLX_RETURN_IF_ERROR(ParseSize("--squares", f.squares, f.stage.board.columns, f.stage.board.rows));
  SLX_RETURN_IF_ERROR(f.stage.board.Validate());
  if (!f.camera_size.empty()) {
    f.stage.camera_size.emplace();
    SLX_RETURN_IF_ERROR(
        ParseSize("--camera-size", f.camera_size, f.stage.camera_size->width, f.stage.camera_size->height));
  }
  if (!f.projector_size.empty()) {
    f.stage.projector_size.emplace();
    SLX_RETURN_IF_ERROR(
        ParseSize("--projector-size", f.projector_size, f.stage.projector_size->width, f.stage.projector_size->height));
  }
  if (f.distortion != "auto") {
    SLX_ASSIGN_OR_RETURN(options.distortion, ParseDistortionModel(f.distortion).WithContext("--distortion"));
  }
  if (!f.known_camera.empty()) {
    SLX_ASSIGN_OR_RETURN(const RigCalibration record, ReadRecord("--known-camera", f.known_camera));
    options.known_camera = record.camera.model;
  }
  return options;
}

// The number of a session's one pose; nullopt: none, or several.
std::optional<int> OnlyPose(const std::string& store, const std::string& session) {
  const auto frames = SessionFrames::Open(store, session);
  if (!frames.ok()) return std::nullopt;
  std::vector<int> poses = frames->poses();
  std::erase(poses, -1);  // pre-roll frames belong to none
  return poses.size() == 1 ? std::optional(poses[0]) : std::nullopt;
}

// The sessions named, or the newest of kind calibration that hold `last` poses, oldest first. Attempts at one pose
// count once.
Result<std::vector<std::string>> ChooseSessions(const CalibrateFlags& f, Logger& logger) {
  if (f.last > 0 && !f.sessions.empty()) return Status::Usage("give sessions or --last, not both");
  if (f.last == 0) {
    std::vector<std::string> chosen = f.sessions.empty() ? std::vector<std::string>{"latest"} : f.sessions;
    for (std::string& session : chosen) {
      SLX_ASSIGN_OR_RETURN(session, ChooseSession(f.store, session, SessionUse::kCalibration, logger));
    }
    return chosen;
  }
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(f.store, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto rows, store.ListSessions());
  std::vector<std::string> chosen;
  int poses = 0;
  std::set<int> attempted;
  for (const db::SessionSummary& row : rows) {
    if (row.info.kind == SessionKind::kVisitor || row.info.status == SessionStatus::kFailed || poses == f.last)
      continue;
    if (row.info.kind == SessionKind::kCalibration) {
      const auto pose = OnlyPose(f.store, row.info.id);
      poses += !pose || attempted.insert(*pose).second;
    }
    chosen.push_back(row.info.id);
  }
  if (poses < f.last)
    return Status::NotFound("--last " + std::to_string(f.last) + ": the store has " + std::to_string(poses) +
                            " poses in sessions of kind calibration");
  std::reverse(chosen.begin(), chosen.end());
  return chosen;
}

// Made when the newest of its sessions was captured: calibrating the same captures again makes nothing newer.
// A record that has its time, of which light alone is new, keeps it, and its validity unless --valid-days says
// otherwise.
Status StampValidity(const CalibrateFlags& f, const std::vector<std::string>& sessions, RigCalibration& record) {
  if (record.made_wall.ns != 0 && !f.valid_days) return Status::Ok();
  if (record.made_wall.ns == 0) {
    SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(f.store, db::AccessMode::kReadOnly));
    for (const std::string& id : sessions) {
      SLX_ASSIGN_OR_RETURN(const auto row, store.FindSession(id));
      const WallNs ended = row.info.finished_wall.ns != 0 ? row.info.finished_wall : row.info.started_wall;
      record.made_wall = std::max(record.made_wall, ended);
    }
  }
  record.valid_until_wall.ns =
      record.made_wall.ns + static_cast<int64_t>(f.valid_days.value_or(kCalibrationValidDays) * 86400e9);
  return Status::Ok();
}

Status WriteLine(const std::filesystem::path& file, const std::string& text) { return WriteText(file, text + "\n"); }

// Beside --out and where --page says, whether accepted or refused.
Status WritePage(const CalibrateFlags& f, const std::string& html) {
  if (!f.out.empty()) SLX_RETURN_IF_ERROR(WriteLine(std::filesystem::path(f.out).replace_extension(".html"), html));
  return f.page.empty() ? Status::Ok() : WriteLine(f.page, html);
}

// In the store: a fit of the newest session that it came from.
Result<std::filesystem::path> Register(const CalibrateFlags& f, const std::vector<std::string>& sessions,
                                       const std::string& record, const std::string& figures, const std::string& html) {
  const std::string session = sessions.back();
  SLX_ASSIGN_OR_RETURN(auto store, db::SessionStore::Open(f.store, db::AccessMode::kReadWrite));
  nlohmann::ordered_json options = {{"stage", "calibrate"},
                                    {"sessions", sessions},
                                    {"board", f.board},
                                    {"squares", f.squares},
                                    {"square_mm", f.stage.board.square_mm},
                                    {"distortion", f.distortion}};
  const std::string fit = db::HashHex(record + options.dump() + kVersion).substr(0, 16);
  const std::filesystem::path folder = store.FitFolder(session, fit);
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return Status::Failed("cannot create " + folder.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(WriteLine(folder / "calibration.json", record));
  SLX_RETURN_IF_ERROR(WriteLine(folder / "calibration_report.json", figures));
  SLX_RETURN_IF_ERROR(WriteLine(folder / "calibration_report.html", html));
  SLX_RETURN_IF_ERROR(store.RegisterFit({fit, session, options.dump(), figures, WallNow()}));
  return folder / "calibration.json";
}

// An earlier calibration of the same box: --known-rig, else what the sessions carry.
Result<std::optional<RigCalibration>> KnownRig(const CalibrateFlags& f,
                                               const std::optional<RigCalibration>& of_sessions) {
  if (f.known_rig.empty()) return of_sessions;
  SLX_ASSIGN_OR_RETURN(const RigCalibration record, ReadRecord("--known-rig", f.known_rig));
  return std::optional(record);
}

// What keeps the light that no session measures.
struct EarlierLight {
  std::optional<RigCalibration> record;
  std::string name;  // LightReport::earlier; empty: there is none
};

// The boards' own record, else --known-rig's, unless that is of another camera or other projectors.
EarlierLight FindEarlierLight(const CalibrateFlags& f, const BoardPoses& boards,
                              const std::optional<RigCalibration>& known) {
  if (boards.calibration) return {boards.calibration, "the earlier record"};
  const CalibrationObservations& o = boards.observations;
  if (!known || known->camera.model.width != o.camera.width || known->camera.model.height != o.camera.height ||
      known->projectors.size() != o.projectors.size())
    return {};
  return {known, "--known-rig " + f.known_rig};
}

std::vector<Finding> Judge(const std::vector<std::string>& left_out, const std::optional<RigCalibration>& known,
                           const GeometryReport& report) {
  std::vector<Finding> findings = JudgeCalibration(report);
  if (known) {
    const auto more = CompareWithKnownRig(RigGeometry::From(*known), report);
    findings.insert(findings.end(), more.begin(), more.end());
  } else {
    findings.push_back({Severity::kWarning,
                        "no earlier calibration of this rig: the size of the squares is taken on trust",
                        "measure it twice, or name a record with --known-rig"});
  }
  for (const std::string& pose : left_out) findings.push_back({Severity::kWarning, pose, "the pose was left out"});
  return findings;
}

// Verdict, record, figures and page where they belong; `accepted`: the exit code unless refused.
Result<int> Conclude(const CalibrateFlags& f, CalibrationPage page, nlohmann::ordered_json& json, std::string& text,
                     int accepted, Logger& logger) {
  SLX_RETURN_IF_ERROR(StampValidity(f, page.sessions, page.record));
  json["verdict"] = VerdictOf(page.findings);
  json["findings"] = nlohmann::ordered_json::parse(FindingsJson(page.findings));
  text += FindingsText(page.findings);
  SLX_ASSIGN_OR_RETURN(const std::string html, RenderHtml(CalibrationReport(page)));
  SLX_RETURN_IF_ERROR(WritePage(f, html));
  if (!IsRefused(page.findings)) {
    const std::string record = page.record.ToJson();
    SLX_ASSIGN_OR_RETURN(const auto file, Register(f, page.sessions, record, json.dump(1), html));
    if (!f.out.empty()) SLX_RETURN_IF_ERROR(WriteLine(f.out, record));
    text += (f.out.empty() ? file.string() : f.out) + "\n";
    text += "page " + (file.parent_path() / "calibration_report.html").string() + "\n";
    json["record"] = f.out.empty() ? file.string() : f.out;
  }
  SLX_RETURN_IF_ERROR(WriteStdout(f.json ? json.dump(1) + "\n" : text));
  if (!IsRefused(page.findings)) return accepted;
  logger.Error("calibration refused; nothing was stored");
  return static_cast<int>(StatusCode::kFailed);
}

// Sessions of boards and of light, each in the order given.
struct SessionsByUse {
  std::vector<std::string> boards, light;
  std::optional<RigCalibration> record;  // of the newest light session
  double saturation_dn = 0.0;            // of the sensor, as that session tells; 0: not known
  Cfa cfa = Cfa::kRggb;                  // of the frames
};

Result<SessionsByUse> SortByUse(const CalibrateFlags& f, const std::vector<std::string>& sessions) {
  SessionsByUse sorted;
  for (const std::string& selector : sessions) {
    SLX_ASSIGN_OR_RETURN(const auto frames, SessionFrames::Open(f.store, selector));
    const SessionKind kind = frames.info().kind;
    if (!frames.rows().empty()) sorted.cfa = frames.rows().front().record.cfa;
    const bool light = kind == SessionKind::kDark || kind == SessionKind::kFlat || kind == SessionKind::kResponse;
    (light ? sorted.light : sorted.boards).push_back(frames.info().id);
    if (light) sorted.saturation_dn = frames.info().devices.saturation_dn;
    if (light && frames.record()) sorted.record = frames.record();
  }
  return sorted;
}

// Nothing to keep: the record holds placeholders.
Finding NeverMeasured(const LightReport& light) {
  std::string what = "the light was never measured: black level 0, gain 1, no responses, vignetting or fall-off";
  if (!light.sessions.empty()) {
    what = "part of the light was never measured";
    for (const std::string& part : light.carried_over) what += "; " + part;
  }
  return {Severity::kWarning, what,
          "capture dark, flat and response, and calibrate with their sessions before the first visitor"};
}

// Without a session of light all of it is as the earlier record (EarlierLight::name) has it.
void AddNoLight(const std::string& earlier, CalibrationPage& page, nlohmann::ordered_json& json, std::string& text) {
  LightReport light;
  light.earlier = earlier;
  light.carried_over = {
      "all light (levels, noise, responses, vignetting, fall-off, white scale, blur): no session of "
      "kind dark, flat or response"};
  if (earlier.empty()) page.findings.push_back(NeverMeasured(light));
  json["light"] = nlohmann::ordered_json::parse(LightJson(light));
  text += LightText(light);
}

// Of the light sessions on the page's geometry: record, figures and findings added to what is there.
Status AddLight(const CalibrateFlags& f, const SessionsByUse& sessions, const std::string& earlier,
                CalibrationPage& page, nlohmann::ordered_json& json, std::string& text, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(auto light, CalibrateLight(f.store, sessions.light, page.record, f.light, logger));
  light.report.earlier = earlier;
  if (earlier.empty() && !light.report.carried_over.empty()) page.findings.push_back(NeverMeasured(light.report));
  page.record = std::move(light.record);
  page.sessions.insert(page.sessions.end(), sessions.light.begin(), sessions.light.end());
  page.findings.insert(page.findings.end(), light.report.findings.begin(), light.report.findings.end());
  json["light"] = nlohmann::ordered_json::parse(LightJson(light.report));
  text += LightText(light.report);
  page.light = std::move(light.report);
  return Status::Ok();
}

// Where the geometry is known already: the light alone.
Result<int> CalibrateLightAlone(const CalibrateFlags& f, const SessionsByUse& sessions, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto known, KnownRig(f, sessions.record));
  if (!known)
    return Status::Usage(
        "the light of a rig needs its geometry: give the sessions of the board's poses, too, or a record with "
        "--known-rig");
  CalibrationPage page;
  page.record = *known;
  AdoptSaturation(sessions.saturation_dn, page.record.camera);
  page.record.id.clear();
  page.record.source = "light calibration session " + sessions.light.back();
  nlohmann::ordered_json json = {{"schema", 1}};
  std::string text;
  const std::string earlier = f.known_rig.empty() ? "the earlier record" : "--known-rig " + f.known_rig;
  SLX_RETURN_IF_ERROR(AddLight(f, sessions, earlier, page, json, text, logger));
  return Conclude(f, page, json, text, 0, logger);
}

Result<int> Calibrate(CalibrateFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const CalibrateOptions options, OptionsFrom(f));
  SLX_ASSIGN_OR_RETURN(const auto sessions, ChooseSessions(f, logger));
  SLX_ASSIGN_OR_RETURN(const SessionsByUse by_use, SortByUse(f, sessions));
  if (by_use.boards.empty()) return CalibrateLightAlone(f, by_use, logger);
  SLX_ASSIGN_OR_RETURN(const BoardPoses boards, ObserveBoards(f.store, by_use.boards, f.stage, logger));
  auto calibrated = CalibrateRig(boards.observations, options);
  if (!calibrated.ok()) {
    std::string also;
    for (const std::string& pose : boards.left_out) also += "; left out: " + pose;
    return Status(calibrated.status().code(), calibrated.status().message() + also);
  }
  const GeometryReport& report = *calibrated;
  SLX_ASSIGN_OR_RETURN(const auto known, KnownRig(f, boards.calibration));
  std::vector<std::string> left_out = boards.left_out;
  left_out.insert(left_out.end(), report.left_out.begin(), report.left_out.end());
  CalibrationPage page{boards.sessions, Judge(left_out, known, report), &report, known};
  const EarlierLight earlier = FindEarlierLight(f, boards, known);
  page.record = ToRecord(report, earlier.record, "calibration session " + boards.sessions.back(), boards.saturation_dn);
  if (!boards.calibration) page.record.camera.cfa = by_use.cfa;
  page.record.made_wall = page.record.valid_until_wall = {};  // not those of the record before
  nlohmann::ordered_json json = nlohmann::ordered_json::parse(ReportJson(report, page.findings, left_out));
  std::string text = ReportText(report);
  if (by_use.light.empty()) AddNoLight(earlier.name, page, json, text);
  if (!by_use.light.empty()) SLX_RETURN_IF_ERROR(AddLight(f, by_use, earlier.name, page, json, text, logger));
  const int accepted = left_out.empty() ? 0 : static_cast<int>(StatusCode::kDegraded);
  return Conclude(f, page, json, text, accepted, logger);
}

// The page says why there is no calibration; wrong flags need none.
int Fail(const CalibrateFlags& f, const Status& status, Logger& logger) {
  logger.Error(status.message());
  if (status.code() == StatusCode::kUsage) return status.exit_code();
  const auto html = RenderHtml(CalibrationReport({f.sessions, {{Severity::kRefusal, status.message(), ""}}}));
  const Status written = html.ok() ? WritePage(f, *html) : html.status();
  if (!written.ok()) logger.Error(written.message());
  return status.exit_code();
}

}  // namespace

void AddCalibrateCommand(CLI::App& app, int& exit_code) {
  auto flags = std::make_shared<CalibrateFlags>();
  auto* verb =
      app.add_subcommand("calibrate",
                         "Calibrate a rig's geometry and light from board poses, dark, flat and response sessions, "
                         "and judge the result");
  verb->footer(
      "The record of an accepted calibration is kept in the store, with its figures; a refused one is not.\n"
      "Exit codes: 0 accepted, 1 refused or failed, 2 usage, 3 accepted without some poses. docs/calibration.md "
      "explains each figure.\n"
      "Sessions of kind calibration give the geometry; dark, flat and response ones the light. Without the former, "
      "the geometry of --known-rig (or the sessions' own) is kept; what no session measures is kept as\n"
      "it was, and named.\n"
      "Examples:\n"
      "  stratalux-fit calibrate --last 12 --store store --out calibration.json\n"
      "  stratalux-fit calibrate s000001 s000002 s000003 s000004 --store store --board charuco --squares 10x7 "
      "--square-mm 20 --marker-mm 15\n"
      "  stratalux-fit calibrate s000013 s000014 s000015 s000016 --store store --known-rig calibration.json "
      "--target-albedo 0.99\n"
      "  stratalux-fit calibrate latest --store store --board chess --squares 10x8 --square-mm 75 --json");
  verb->add_option("session", flags->sessions, "Sessions: ids, unique prefixes, or latest (default)");
  verb->add_option("--store", flags->store, "Store folder")->envname("STRATALUX_STORE")->required();
  verb->add_option("--last", flags->last,
                   "The newest N poses of the board (attempts at one pose count once), and all sessions of kind dark, "
                   "flat and response since the first of them")
      ->check(CLI::Range(1, 1000));
  verb->add_option("--board", flags->board, "charuco or chess")->capture_default_str();
  verb->add_option("--squares", flags->squares, "Squares, COLUMNSxROWS (one more each way than inner corners)")
      ->capture_default_str();
  verb->add_option("--square-mm", flags->stage.board.square_mm, "Side of a square, mm: measure it")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  verb->add_option("--marker-mm", flags->stage.board.marker_mm, "Side of a ChArUco marker, mm")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  verb->add_option("--distortion", flags->distortion, "auto (chosen by held-out poses), k1, k1k2, full")
      ->capture_default_str();
  verb->add_option("--known-camera", flags->known_camera, "Record (JSON) whose camera intrinsics are kept");
  verb->add_option(
      "--known-rig", flags->known_rig,
      "Record (JSON) of the same box, to check size and cables, and to keep light that no session measures "
      "(default: the sessions' own)");
  verb->add_option("--target-albedo", flags->light.target_albedo,
                   "Diffuse albedo of the flat sessions' matt target, as given in its certificate")
      ->check(CLI::Range(0.01, 1.2))
      ->capture_default_str();
  verb->add_option("--camera-size", flags->camera_size,
                   "Full frame of imported crops, WIDTHxHEIGHT (default: as imported)");
  verb->add_option("--projector-size", flags->projector_size,
                   "Picture of imported sessions' projectors, WIDTHxHEIGHT (default: as imported)");
  verb->add_option("--valid-days", flags->valid_days,
                   "Days after its captures when sessions begin to warn of its age (default: 30; for light alone: as "
                   "in the known rig)")
      ->check(CLI::Range(0.01, 36500.0));
  verb->add_option("--out", flags->out, "Write the record here, too, and the page beside it (.html)");
  verb->add_option("--page", flags->page, "Write the page (HTML) here, whether accepted or refused");
  verb->add_flag("--json", flags->json, "Machine-readable result on stdout");
  verb->callback([flags, &exit_code] {
    Logger logger;
    const auto code = Calibrate(*flags, logger);
    exit_code = code.ok() ? *code : Fail(*flags, code.status(), logger);
  });
}

}  // namespace stratalux::fit
