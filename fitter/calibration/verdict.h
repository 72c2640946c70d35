// SPDX-License-Identifier: Apache-2.0
// May this calibration be used? A low training error proves little: each finding names a reason to doubt it, and what
// to do about it (docs/calibration.md).
#pragma once

#include <string>
#include <vector>

#include "fitter/calibration/calibrate_rig.h"

namespace stratalux::fit {

enum class Severity { kWarning, kRefusal };

struct Finding {
  Severity severity = Severity::kWarning;
  std::string what, remedy;
};

struct VerdictOptions {
  double max_held_out_ratio = 2.0;  // held-out over training error
  double negligible_px = 0.02;      // held-out errors that exceed training by less do not count
  double max_aspect = 0.03;         // |fx / fy - 1|
  double max_focal = 0.03;          // against another calibration of the same rig
  double max_focal_sd = 0.01;       // standard deviation of fx or fy over its value
  double max_displacement = 0.25;   // by distortion, anywhere in the picture, over half its diagonal
  double max_rejected = 0.1;        // share of corners
  int min_poses = 4, advised_poses = 10;
  int min_tilted = 3;
  double min_tilt_deg = 10.0;
  double min_tilt_spread_deg = 4.0;  // standard deviation of the tilts in the direction that varies least
  double advised_coverage = 0.4;     // of each device's picture
  double max_scale = 0.02;           // all distances to another calibration's projectors in common
};

[[nodiscard]] bool IsRefused(const std::vector<Finding>& findings);

// Our own result.
[[nodiscard]] std::vector<Finding> JudgeCalibration(const GeometryReport& report, const VerdictOptions& options = {});
// A result from elsewhere, such as one made by another program, against the corners that `report` was made from.
[[nodiscard]] std::vector<Finding> JudgeGiven(const RigGeometry& given, const GeometryReport& report,
                                              const VerdictOptions& options = {});
// Our own result against an earlier calibration of the same rig, whose box is known: wrong square size, exchanged
// projectors, a projector that was moved.
[[nodiscard]] std::vector<Finding> CompareWithKnownRig(const RigGeometry& known, const GeometryReport& report,
                                                       const VerdictOptions& options = {});

}  // namespace stratalux::fit
