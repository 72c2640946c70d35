// SPDX-License-Identifier: Apache-2.0
// Captures for a calibration, with the operator led through them: a series of board poses, or one dark, flat or
// response session.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "firmware-host/apps/capture_command.h"
#include "firmware-host/calibration/coverage.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

enum class Answer { kGo, kBack, kQuit };
// Shows a text and waits for what the operator decides.
using AskOperator = std::function<Answer(const std::string& text)>;

// On the terminal: Enter goes on, b goes back by one pose (where there are `poses`), q ends; the end of stdin and a
// stop signal end, too.
[[nodiscard]] AskOperator AskOnTerminal(StopToken& stop, bool poses);

struct SeriesOptions {
  int first = 0;         // number of the first pose: > 0 goes on with a series that was broken off
  int poses = 12;        // behind the last
  int max_attempts = 3;  // captures of a pose, before the next one is asked for
};

struct PoseOutcome {
  int pose = 0;
  int attempts = 0;
  bool usable = false;     // the last attempt's session is complete and nothing was objected to
  CaptureOutcome capture;  // of the last attempt
  std::vector<std::string> notes;
};

struct SeriesOutcome {
  std::vector<PoseOutcome> poses;
  CoverageMap camera;  // of the usable poses
  std::vector<CoverageMap> projectors;
  bool finished = false;   // not ended by the operator, a signal or an error
  std::string error = {};  // which one: of a later pose than the first, so that those before are told
  int first = 0;           // pose of this series
  int next = 0;            // pose at which an unfinished one goes on
  int end = 0;             // behind the last pose
};

// One session a pose, the rig opened for each: between them the operator's hands are in the box, and an open door or a
// pressed E-STOP stops nobody who captures nothing. A pose that went wrong is captured again at once: after the
// operator mended what is named, or, where nobody is asked (`ask` empty), if another try may go well. Fails as Capture
// does.
[[nodiscard]] Result<SeriesOutcome> CaptureSeries(const CaptureJob& job, const SeriesOptions& series,
                                                  const AskOperator& ask, StopToken& stop, Logger& logger);
// One session: a board pose, or of kind dark, flat or response, looked at while it is captured: board_watch.h,
// light_watch.h. A visitor's is captured as it is. Where START begins it, nobody is asked. Fails as Capture does.
[[nodiscard]] Result<CaptureOutcome> CaptureOne(const CaptureJob& job, const AskOperator& ask, StopToken& stop,
                                                Logger& logger);

// For people: one line a pose, coverage, and the command that calibrates. One JSON object for programs: {"poses":
// [{"pose", "session", "status", "usable", "attempts", "reasons", "notes"}], "finished", "error" (where one ended it),
// "sessions": [usable ones], "coverage": {"camera": {"share", "rows"}, "projectors": [...]}}.
[[nodiscard]] std::string SeriesAsText(const SeriesOutcome& outcome, const std::string& store);
[[nodiscard]] std::string SeriesAsJson(const SeriesOutcome& outcome);
// 0 all poses usable, 3 some are not, 1 ended early or none is.
[[nodiscard]] int ExitCode(const SeriesOutcome& outcome);

}  // namespace stratalux::rig
