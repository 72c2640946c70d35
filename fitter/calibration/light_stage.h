// SPDX-License-Identifier: Apache-2.0
// Light calibration from sessions of kind dark, flat and response, on a rig whose geometry is known.
#pragma once

#include <string>
#include <vector>

#include "fitter/calibration/light_report.h"
#include "fitter/session/session_frames.h"
#include "shared/base/log.h"

namespace stratalux::fit {

struct LightStageOptions {
  double target_albedo = 1.0;  // of the flat sessions' target, all colours: its certificate's value
  [[nodiscard]] Status Validate() const;
};

struct LightCalibration {
  LightReport report;
  RigCalibration record;  // `rig` with what the sessions told
};

// Dark sessions first, then the exposure ramp of the flat ones, projector ramps, and last the light field, which needs
// all of these. What no session tells stays as `rig` has it and is listed in `carried_over`; what a session tells badly
// is a finding. kUsage: a session of another kind, rig or size.
[[nodiscard]] Result<LightCalibration> CalibrateLight(const std::string& store,
                                                      const std::vector<std::string>& sessions,
                                                      const RigCalibration& rig, const LightStageOptions& options,
                                                      Logger& logger);

}  // namespace stratalux::fit
