// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig capture`: a plan, a rig and a store make a session.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "firmware-host/calibration/capture_watch.h"
#include "firmware-host/config/rig_config.h"
#include "firmware-host/sequence/capture_report.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/capture/session.h"

namespace stratalux::rig {

struct CaptureOptions {
  RigConfig config;     // store, plan, devices, deadlines, queue
  std::string visitor;  // pseudonym
  // Recorded for the visitor before the capture; without one, the store must hold a consent already.
  std::optional<Consent> consent;
  Retention retention = Retention::kStandard;
  int board_pose = -1;                           // calibration: number of the board's pose; -1: none
  std::optional<SimulatedRigOptions> simulated;  // in place of the devices of `config`

  // kUsage: no devices and no simulation, a pseudonym that not every list and JSON file can show, a consent without a
  // visitor.
  [[nodiscard]] Status Validate() const;
};

struct CaptureOutcome {
  std::string session;
  CaptureReport report;
  std::vector<InjectedFault> injected;  // simulation
  double seconds = 0.0;
};

// Runs a whole capture and stores it; a simulated one with its truth maps. Fails where no session came to be (a bad
// plan, no such device or store, a visitor without consent: kUsage with the command that records it); a session that
// went wrong is an outcome whose report says why.
// `watch` sees every frame; what it objects to makes a complete session a degraded one.
[[nodiscard]] Result<CaptureOutcome> Capture(const CaptureOptions& options, StopToken& stop, Logger& logger,
                                             CaptureWatch* watch = nullptr);

// One line for people; one JSON object for programs.
[[nodiscard]] std::string OutcomeAsText(const CaptureOutcome& outcome);
[[nodiscard]] std::string OutcomeAsJson(const CaptureOutcome& outcome);
// 0 complete, 3 degraded, 1 failed.
[[nodiscard]] int ExitCode(const CaptureOutcome& outcome);

}  // namespace stratalux::rig
