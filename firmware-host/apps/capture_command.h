// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig capture`: what it was asked for, and what came of it.
#pragma once

#include <string>

#include "firmware-host/session/capture_station.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

struct CaptureJob {
  StationOptions station;
  CaptureRequest request;
  // A visitor's: the pre-scan chooses the exposure, such that the visit takes no longer than the configuration allows.
  bool choose_exposure = false;
  VisitTiming timing;
  bool on_start = false;  // it begins when START is pressed (start_wait.h)
};

// As CaptureStation::Capture, with a progress bar. `watch` may be null.
[[nodiscard]] Result<CaptureOutcome> CaptureWithProgress(CaptureStation& station, const CaptureRequest& request,
                                                         Logger& logger, CaptureObserver* watch = nullptr);

// The pre-scan: the request with the exposure that it chose, told to people.
[[nodiscard]] Result<CaptureRequest> WithChosenExposure(CaptureStation& station, const CaptureJob& job, Logger& logger);

// One line and the reasons for people; one JSON object for programs.
[[nodiscard]] std::string OutcomeAsText(const CaptureOutcome& outcome);
[[nodiscard]] std::string OutcomeAsJson(const CaptureOutcome& outcome);
// 0 complete, 3 degraded, 1 failed.
[[nodiscard]] int ExitCode(const CaptureOutcome& outcome);

}  // namespace stratalux::rig
