// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/guided_capture.h"

#include <algorithm>

#include <nlohmann/json.hpp>
#include <poll.h>
#include <unistd.h>

#include "firmware-host/calibration/board_watch.h"
#include "firmware-host/calibration/instructions.h"
#include "firmware-host/calibration/light_watch.h"
#include "firmware-host/session/start_wait.h"

namespace stratalux::rig {
namespace {

using Json = nlohmann::ordered_json;

// One line of stdin without its end; false at the end of stdin or when `stop` is set.
bool ReadLine(StopToken& stop, std::string& line) {
  constexpr int kLookMs = 100;
  line.clear();
  while (!stop.stopped()) {
    pollfd input{STDIN_FILENO, POLLIN, 0};
    if (poll(&input, 1, kLookMs) <= 0) continue;
    char c = 0;
    if (read(STDIN_FILENO, &c, 1) != 1) return false;
    if (c == '\n') return true;
    line += c;
  }
  return false;
}

BoardWatchOptions BoardOptions(const RigConfig& config) {
  BoardWatchOptions options;
  options.projectors = config.plan.projectors;
  options.projector_width = config.plan.projector_width;
  options.projector_height = config.plan.projector_height;
  options.saturation_dn = config.camera.saturation_dn;
  options.exposure_ms = config.plan.exposure_ms;
  return options;
}

// What cannot go well is refused before the rig moves.
Result<std::unique_ptr<CaptureStation>> OpenFor(const CaptureJob& job, StopToken& stop, Logger& logger) {
  SLX_RETURN_IF_ERROR(CaptureStation::MayBegin(job.station, job.request));
  return CaptureStation::Open(job.station, stop, logger);
}

struct Attempt {
  CaptureOutcome capture;
  BoardSighting sighting;

  [[nodiscard]] bool usable() const { return capture.report.status == SessionStatus::kComplete; }
  // May go well with nothing changed.
  [[nodiscard]] bool by_chance() const {
    return std::all_of(sighting.faults.begin(), sighting.faults.end(), [](const auto& f) { return f.by_chance; });
  }
};

Result<Attempt> CapturePose(CaptureJob job, int pose, int number, StopToken& stop, Logger& logger) {
  job.request.board_pose = pose;
  job.request.attempt = number;
  if (job.station.simulated) job.station.simulated->board_pose = pose;
  SLX_ASSIGN_OR_RETURN(const auto station, OpenFor(job, stop, logger));
  BoardWatch watch(BoardOptions(job.station.config));
  Attempt attempt;
  SLX_ASSIGN_OR_RETURN(attempt.capture, CaptureWithProgress(*station, job.request, logger, &watch));
  attempt.sighting = watch.Judge();
  return attempt;
}

std::string Percent(double share) { return std::to_string(static_cast<int>(100.0 * share + 0.5)) + " %"; }

std::string CoverageLine(const SeriesOutcome& outcome) {
  std::string text = "covered so far: camera " + Percent(outcome.camera.Share());
  for (size_t p = 0; p < outcome.projectors.size(); ++p)
    text += ", projector " + std::to_string(p) + " " + Percent(outcome.projectors[p].Share());
  return text;
}

// The devices' maps side by side.
std::string CoverageMaps(const SeriesOutcome& outcome) {
  std::string text = "  camera    ";
  for (size_t p = 0; p < outcome.projectors.size(); ++p) text += "projector " + std::to_string(p) + " ";
  text += "\n";
  for (int row = 0; row < CoverageMap::kRows; ++row) {
    text += "  " + outcome.camera.RowText(row);
    for (const CoverageMap& map : outcome.projectors) text += "    " + map.RowText(row);
    text += "\n";
  }
  return text;
}

std::string Reasons(const CaptureOutcome& capture) {
  std::string text;
  for (const std::string& reason : capture.report.Reasons()) text += (text.empty() ? "" : "; ") + reason;
  return text;
}

bool HasSessions(const SeriesOutcome& outcome) {
  return std::ranges::any_of(outcome.poses, [](const PoseOutcome& pose) { return !pose.capture.session.empty(); });
}

// Captures one pose until it is usable. Else than kGo: the operator went back; the operator or a signal ended the
// series.
Result<Answer> CaptureUntilUsable(const CaptureJob& job, const SeriesOptions& series, const AskOperator& ask,
                                  StopToken& stop, Logger& logger, PoseOutcome& pose, SeriesOutcome& outcome) {
  const std::string name = "pose " + std::to_string(pose.pose);
  while (pose.attempts < series.max_attempts) {
    Result<Attempt> captured = CapturePose(job, pose.pose, pose.attempts + 1, stop, logger);
    // What was captured before is not lost to a stop between two captures, nor to a disk that is full by now.
    if (!captured.ok() && stop.stopped()) return Answer::kQuit;
    if (!captured.ok() && HasSessions(outcome)) {
      outcome.error = captured.status().WithContext(name).message();
      logger.Error(outcome.error);
      return Answer::kQuit;
    }
    SLX_ASSIGN_OR_RETURN(Attempt attempt, std::move(captured));
    ++pose.attempts;
    pose.capture = std::move(attempt.capture);
    pose.notes = attempt.sighting.notes;
    pose.usable = attempt.usable();
    for (const std::string& note : pose.notes) logger.Warning(name + ": " + note);
    if (pose.usable) {
      outcome.camera.Add(attempt.sighting.camera);
      for (size_t p = 0; p < outcome.projectors.size(); ++p) outcome.projectors[p].Add(attempt.sighting.projectors[p]);
      return Answer::kGo;
    }
    logger.Warning(name + " went wrong: " + Reasons(pose.capture));
    if (stop.stopped()) return Answer::kQuit;
    if (pose.attempts == series.max_attempts) break;
    if (!ask && !attempt.by_chance()) break;
    if (!ask) continue;
    if (const Answer answer = ask(name + " again. Fix what is named above"); answer != Answer::kGo) return answer;
  }
  return Answer::kGo;
}

// The outcome of this pose: of an earlier attempt, gone back to, or a new one.
PoseOutcome& SlotOf(SeriesOutcome& outcome, int pose) {
  std::erase_if(outcome.poses, [pose](const PoseOutcome& p) { return p.pose == pose; });
  PoseOutcome& slot = outcome.poses.emplace_back();
  slot.pose = pose;
  return slot;
}

Json CoverageJson(const CoverageMap& map) {
  Json rows = Json::array();
  for (int row = 0; row < CoverageMap::kRows; ++row) rows.push_back(map.RowText(row));
  return {{"share", map.Share()}, {"rows", rows}};
}

std::vector<std::string> UsableSessions(const SeriesOutcome& outcome) {
  std::vector<std::string> sessions;
  for (const PoseOutcome& pose : outcome.poses)
    if (pose.usable) sessions.push_back(pose.capture.session);
  return sessions;
}

}  // namespace

AskOperator AskOnTerminal(StopToken& stop, bool poses) {
  return [&stop, poses](const std::string& text) {
    std::string line;
    while (true) {
      Say(LogLevel::kInfo, text + "\n[Enter: capture, " + (poses ? "b: the pose before, " : "") + "q: end] ");
      if (!ReadLine(stop, line)) {
        Say(LogLevel::kWarning, "\nno answer on stdin (--yes captures without asking)\n");
        return Answer::kQuit;
      }
      if (line.empty()) return Answer::kGo;
      if (poses && line == "b") return Answer::kBack;
      if (line == "q") return Answer::kQuit;
    }
  };
}

Result<SeriesOutcome> CaptureSeries(const CaptureJob& job, const SeriesOptions& series, const AskOperator& ask,
                                    StopToken& stop, Logger& logger) {
  SLX_RETURN_IF_ERROR(CaptureStation::MayBegin(job.station, job.request));
  SeriesOutcome outcome;
  outcome.projectors.resize(static_cast<size_t>(job.request.plan.projectors));
  outcome.first = series.first;
  outcome.end = series.poses;
  int& pose = outcome.next;
  pose = series.first;
  while (pose < series.poses) {
    const std::string text = "pose " + std::to_string(pose) + " (" + std::to_string(pose - series.first + 1) + " of " +
                             std::to_string(series.poses - series.first) + ")";
    if (ask) {
      const Answer answer =
          ask(CoverageMaps(outcome) + text + ": hold the board " + PoseInstruction(pose) + ". Fix it in place there");
      if (answer == Answer::kQuit) return outcome;
      if (answer == Answer::kBack) {
        pose = std::max(series.first, pose - 1);
        continue;
      }
    } else {
      logger.Info(text);
    }
    SLX_ASSIGN_OR_RETURN(const Answer answer,
                         CaptureUntilUsable(job, series, ask, stop, logger, SlotOf(outcome, pose), outcome));
    logger.Info(CoverageLine(outcome));
    if (answer == Answer::kQuit) {
      std::erase_if(outcome.poses, [](const PoseOutcome& p) { return p.attempts == 0; });
      return outcome;
    }
    pose = answer == Answer::kBack ? std::max(series.first, pose - 1) : pose + 1;
  }
  outcome.finished = true;
  return outcome;
}

Result<CaptureOutcome> CaptureOne(const CaptureJob& job, const AskOperator& ask, StopToken& stop, Logger& logger) {
  const RigConfig& config = job.station.config;
  const SessionKind kind = job.request.plan.kind;
  const bool of_light = kind != SessionKind::kVisitor && kind != SessionKind::kCalibration;
  if (of_light && job.on_start) logger.Info(LightInstruction(kind, job.request.board_pose));
  if (of_light && !job.on_start && ask && ask(LightInstruction(kind, job.request.board_pose)) != Answer::kGo)
    return Status::Failed("ended before the capture; nothing was stored");
  SLX_ASSIGN_OR_RETURN(const auto station, OpenFor(job, stop, logger));
  if (job.on_start) SLX_RETURN_IF_ERROR(AwaitStart(*station, stop, logger));
  if (kind == SessionKind::kVisitor) {
    CaptureRequest request = job.request;
    if (job.choose_exposure) {
      SLX_ASSIGN_OR_RETURN(request, WithChosenExposure(*station, job, logger));
    }
    return CaptureWithProgress(*station, request, logger);
  }
  if (kind == SessionKind::kCalibration) {
    // Who captures a single pose knows which.
    BoardWatch watch(BoardOptions(config));
    return CaptureWithProgress(*station, job.request, logger, &watch);
  }
  LightWatchOptions light;
  light.kind = kind;
  light.projectors = config.plan.projectors;
  light.saturation_dn = config.camera.saturation_dn;
  light.exposure_ms = config.plan.exposure_ms;
  LightWatch watch(light);
  return CaptureWithProgress(*station, job.request, logger, &watch);
}

std::string SeriesAsText(const SeriesOutcome& outcome, const std::string& store) {
  std::string text;
  for (const PoseOutcome& pose : outcome.poses) {
    text += "pose " + std::to_string(pose.pose) + ": " + (pose.usable ? "usable" : "NOT usable") + ", session " +
            pose.capture.session + (pose.attempts > 1 ? ", attempt " + std::to_string(pose.attempts) : "") + "\n";
    if (!pose.usable) text += "  " + Reasons(pose.capture) + "\n";
  }
  if (!outcome.finished)
    text += "the series was ended early" + (outcome.error.empty() ? "" : " (" + outcome.error + ")") +
            "; continue it with --pose " + std::to_string(outcome.next) + " --poses " + std::to_string(outcome.end) +
            "\n";
  text += CoverageMaps(outcome);
  const auto sessions = UsableSessions(outcome);
  if (sessions.empty()) return text;
  const bool all = outcome.finished && outcome.first == 0;
  text += all ? "next: " : "next, with the sessions of the other poses: ";
  text += "stratalux-fit calibrate --store " + store;
  for (const std::string& session : sessions) text += " " + session;
  return text + "\n";
}

std::string SeriesAsJson(const SeriesOutcome& outcome) {
  Json poses = Json::array(), projectors = Json::array();
  for (const PoseOutcome& pose : outcome.poses)
    poses.push_back({{"pose", pose.pose},
                     {"session", pose.capture.session},
                     {"status", ToString(pose.capture.report.status)},
                     {"usable", pose.usable},
                     {"attempts", pose.attempts},
                     {"reasons", pose.capture.report.Reasons()},
                     {"notes", pose.notes}});
  for (const CoverageMap& map : outcome.projectors) projectors.push_back(CoverageJson(map));
  Json json = {{"poses", poses},
               {"finished", outcome.finished},
               {"sessions", UsableSessions(outcome)},
               {"coverage", {{"camera", CoverageJson(outcome.camera)}, {"projectors", projectors}}}};
  if (!outcome.error.empty()) json["error"] = outcome.error;
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

int ExitCode(const SeriesOutcome& outcome) {
  const size_t usable = UsableSessions(outcome).size();
  if (!outcome.finished || usable == 0) return static_cast<int>(StatusCode::kFailed);
  return static_cast<int>(usable == outcome.poses.size() ? StatusCode::kOk : StatusCode::kDegraded);
}

}  // namespace stratalux::rig
