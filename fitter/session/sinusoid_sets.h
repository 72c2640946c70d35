// SPDX-License-Identifier: Apache-2.0
// Which sets of shifted sinusoids a session holds.
#pragma once

#include <vector>

#include "fitter/session/session_frames.h"

namespace stratalux::fit {

// As files and messages name it.
[[nodiscard]] const char* AxisName(PatternAxis axis);

// Sinusoids of one period along an axis.
struct SinusoidSet {
  int period_px = 0, shifts = 0;
  std::vector<const db::FrameRow*> rows = {};  // of those that were captured, in shift order

  [[nodiscard]] bool IsWhole() const { return shifts > 0 && rows.size() == static_cast<size_t>(shifts); }
};

// Of the plan, or by what an import shows: whole sets before others, of either the finest first. Rows are the
// session's.
[[nodiscard]] std::vector<SinusoidSet> SinusoidSets(const SessionFrames& frames, int projector, int pose,
                                                    PatternAxis axis);

}  // namespace stratalux::fit
