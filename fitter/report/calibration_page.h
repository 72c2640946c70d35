// SPDX-License-Identifier: Apache-2.0
// The page of a calibration: verdict with reasons and remedies, then every figure with what a good one looks like
// (docs/calibration.md). Refused calibrations have one, too.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "fitter/calibration/calibrate_rig.h"
#include "fitter/calibration/light_report.h"
#include "fitter/calibration/verdict.h"
#include "fitter/report/html_report.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

struct CalibrationPage {
  std::vector<std::string> sessions;         // ids
  std::vector<Finding> findings;             // of geometry and light
  const GeometryReport* geometry = nullptr;  // none: no calibration came about, `findings` says why
  std::optional<RigCalibration> earlier{};   // of the same rig, to show what changed
  std::optional<LightReport> light{};        // none: no session told of light
  RigCalibration record{};                   // what came out
};

[[nodiscard]] Report CalibrationReport(const CalibrationPage& page);

}  // namespace stratalux::fit
