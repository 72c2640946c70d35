// SPDX-License-Identifier: Apache-2.0
// The figures of a light calibration, for programs and for people (docs/calibration.md explains each).
#pragma once

#include <string>

#include "fitter/calibration/light_report.h"

namespace stratalux::fit {

// JSON object: {"sessions", "target_albedo", "dark": {"frames", "black_level_dn", "offset_spread_dn", "read_noise_dn",
// "dark_current_dn_per_s", "hot_pixels"}, "photon_transfer": {"gain_e_per_dn", "gain_sd", "read_noise_dn", "signal_dn",
// "variance_dn2"}, "camera_response": {"response", "largest_deviation", "residual", "reached", "exposures_ms"},
// "vignetting", "vignetting_sd", "camera_blur_px", "flats": [{"session", "tilt_deg", "distance_mm", "plane_rms_mm",
// "lit_share", "residual"}], "projectors": [{"name", "response", "largest_deviation", "lamp_drift", "worst_fall",
// "falloff", "falloff_sd", "white_dn_mm2_per_ms", "black_level", "line_blur_px", "line": {"width_px", "measured_px",
// "mm", "fwhm_mm", "offset_px", "light"}}], "carried_over": [text], or "never_measured": [text] where there was no
// record before}. What no session told is absent.
[[nodiscard]] std::string LightJson(const LightReport& report);

// The same for people, some lines; without the findings.
[[nodiscard]] std::string LightText(const LightReport& report);

}  // namespace stratalux::fit
