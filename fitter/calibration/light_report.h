// SPDX-License-Identifier: Apache-2.0
// What light calibration found out, device by device (docs/math/calibration.md, "Light"). Parts that no session told
// are absent; the record then keeps what it had before (`carried_over`).
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "fitter/calibration/verdict.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// From kind dark: the lens covered, several exposures.
struct DarkReport {
  int frames = 0;
  double black_level_dn = 0.0;         // mean over the sites, at exposure 0
  double offset_spread_dn = 0.0;       // standard deviation of the sites' offsets (DSNU), noise taken out
  double read_noise_dn = 0.0;          // temporal, median over the sites' blocks; quantisation taken out
  int step_dn = 1;                     // between the levels that occur: 4 of 10 bits in the upper ones of 12
  double dark_current_dn_per_s = 0.0;  // median over the sites
  int64_t hot_pixels = 0;
  Image<float> offset_dn;          // raw sites, H x W: level at exposure 0
  Image<float> read_noise_dn_map;  // raw sites, H x W: temporal standard deviation
  Image<uint8_t> hot;              // raw sites, H x W: 1 where the dark signal stands out
};

// One level of the photon transfer: two whites of one exposure, of all sites of about one level.
struct TransferPoint {
  double signal_dn = 0.0;     // above black
  double variance_dn2 = 0.0;  // of one frame
  int64_t sites = 0;
};

struct PhotonTransfer {
  double gain_e_per_dn = 0.0, gain_sd = 0.0;
  double read_noise_dn = 0.0;         // from the intercept; the dark session's is the better one
  int step_dn = 1;                    // as above
  std::vector<TransferPoint> points;  // rising signal
};

// From the exposure ramp of kind flat.
struct CameraResponseReport {
  std::vector<double> response;  // CameraCalibration::response
  double largest_deviation =
      0.0;                // of the raw levels from a straight line through black and saturation, share of range
  double residual = 0.0;  // rms of the ramps about the curve, share of range
  double reached = 0.0;   // brightest level measured, share of range; the curve goes on straight above it
  std::vector<double> exposures_ms;
};

struct FlatPoseReport {
  std::string session;
  int pose = -1;
  double tilt_deg = 0.0, distance_mm = 0.0;  // of the target's plane at the picture's middle
  double plane_rms_mm = 0.0;                 // of the triangulated points
  double lit_share = 0.0;                    // of the target's sites that were used
  double residual = 0.0;                     // of the light field's fit, relative, rms
};

// Width of one projected line on the matt target.
struct ProjectedLine {
  int width_px = 0;               // planned
  double measured_px = 0.0;       // light of the line over the light of white: its equivalent width, columns
  double mm = 0.0;                // the same on the target, in the middle of its poses
  double fwhm_mm = 0.0;           // of the profile in focus blur, without the camera's footprint
  std::vector<double> offset_px;  // of the profile: distance from the line's centre, columns
  std::vector<double> light;      // and the light there, as a share of white
};

struct ProjectorLightReport {
  std::string name;
  // From kind response.
  std::vector<double> response;    // ProjectorCalibration::response
  double largest_deviation = 0.0;  // from a straight line
  double lamp_drift = 0.0;         // largest change of white during the ramp, relative
  double worst_fall = 0.0;         // by which the measured ramp fell anywhere; isotonic regression took it out
  // From kind flat.
  std::optional<std::array<double, 2>> falloff;
  double falloff_sd = 0.0;  // standard deviation of the light at r = 1, relative
  std::array<double, 3> white_dn_mm2_per_ms{};
  std::optional<double> black_level;
  std::optional<double> line_blur_px;
  std::optional<ProjectedLine> line;
};

struct LightReport {
  std::vector<std::string> sessions;
  double target_albedo = 1.0;
  std::optional<DarkReport> dark;
  std::optional<PhotonTransfer> transfer;
  std::optional<CameraResponseReport> camera_response;
  std::optional<std::array<double, 2>> vignetting;
  double vignetting_sd = 0.0;  // at r = 1
  std::optional<double> camera_blur_px;
  std::vector<FlatPoseReport> flats;
  std::vector<ProjectorLightReport> projectors;
  std::vector<std::string> carried_over;  // what stays as the record before had it, and why
  // What that record is called; empty: there is none, and what is carried over are the record's defaults.
  std::string earlier = "the earlier record";
  std::vector<Finding> findings;  // with the session and the remedy in each
};

}  // namespace stratalux::fit
