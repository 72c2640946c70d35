// SPDX-License-Identifier: Apache-2.0
// The matt target of a flat session: where it stands, told by its own codes, and what light it sends back.
#pragma once

#include <vector>

#include "fitter/calibration/light_field.h"
#include "fitter/calibration/light_report.h"
#include "fitter/calibration/line_profile.h"
#include "fitter/session/session_frames.h"

namespace stratalux::fit {

struct FlatTarget {
  FlatPoseReport report;
  std::vector<FlatSample> samples;      // white_dn: white less black; the projector's own black still to be added
  std::vector<BlackSample> blacks;      // empty: no frame with all projectors black
  std::vector<LineSamples> lines;       // by projector and half of its footprints, 2 p and 2 p + 1
  std::vector<double> mm_per_column;    // by projector, in the target's middle
  std::vector<double> saturated;        // by projector: share of the target's sites
  std::vector<double> median_white_dn;  // by projector
};

// `frames` read linear light (SessionFrames::UseRecord); geometry is that of frames.calibration(). kFailed: no plane,
// codes that do not decode, the reason and the remedy.
[[nodiscard]] Result<FlatTarget> MeasureFlat(const SessionFrames& frames, int pose_index);

// Rows of a session by step, the last good shot of each; step order.
[[nodiscard]] std::vector<const db::FrameRow*> GoodRows(const SessionFrames& frames);

}  // namespace stratalux::fit
