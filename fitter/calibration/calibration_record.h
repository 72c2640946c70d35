// SPDX-License-Identifier: Apache-2.0
// The result of a calibration as the record that sessions carry, and as figures for programs.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "fitter/calibration/verdict.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

// The level at which the sensor of the frames at hand saturates; 0, not known, changes nothing. Nor does any where the
// camera has a response, which is a curve over the range up to the saturation that it was measured with.
void AdoptSaturation(double saturation_dn, CameraCalibration& camera);

// Geometry and covariance of `report`, and the saturation (AdoptSaturation). What neither tells (levels, noise, blur,
// light) stays as `earlier` has it; without one, as the record's defaults have it, with unit light.
[[nodiscard]] RigCalibration ToRecord(const GeometryReport& report, const std::optional<RigCalibration>& earlier,
                                      const std::string& source, double saturation_dn = 0.0);

// JSON, schema 1: {"schema", "verdict": "accepted"|"refused", "findings": [{"severity", "what", "remedy"}],
// "left_out": [text], "distortion", "trials": [{"model", "held_out_sigmas", "held_out_px"}], "joint_rms_px",
// "held_out_joint_px", "corners", "rejected": [{"pose", "corner", "sigmas"}], "devices": [{"name", "rms_px",
// "held_out_px", "sigma_px", "epipolar_px" (projectors), "parameters": {name: [value, sd]}, "coverage",
// "coverage_map"}], "poses": [{"name", "tilt_deg", "rms_px", "held_out_px"}]}.
[[nodiscard]] std::string ReportJson(const GeometryReport& report, const std::vector<Finding>& findings,
                                     const std::vector<std::string>& left_out);

// The same for people, some lines, without the findings.
[[nodiscard]] std::string ReportText(const GeometryReport& report);

// "accepted" or "refused"; the findings as a JSON array and as lines, the verdict last.
[[nodiscard]] const char* VerdictOf(const std::vector<Finding>& findings);
[[nodiscard]] std::string FindingsJson(const std::vector<Finding>& findings);
[[nodiscard]] std::string FindingsText(const std::vector<Finding>& findings);

}  // namespace stratalux::fit
