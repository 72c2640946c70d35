// SPDX-License-Identifier: Apache-2.0
// What each set of sinusoids of a session is seen with: its modulation, of captures and imports, calibrated or not.
#pragma once

#include <string>
#include <vector>

#include "fitter/separation/modulation.h"
#include "fitter/session/session_frames.h"

namespace stratalux::fit {

// Of one whole set.
struct SetModulation {
  PatternAxis axis = PatternAxis::kColumns;
  int period_px = 0, shifts = 0;
  Modulation modulation;
};

// Sinusoids of a projector and pose.
struct SinusoidPlace {
  int projector = 0, pose = -1;
  [[nodiscard]] std::string ToString() const;
};
// Where the session has any, whole sets or not.
[[nodiscard]] std::vector<SinusoidPlace> SinusoidPlaces(const SessionFrames& frames);

// Sets that MeasureSets leaves out, with the shifts that they lack; of two sets of one period the one of fewer shifts.
// Empty: none.
[[nodiscard]] std::string UnreadSets(const SessionFrames& frames, const SinusoidPlace& place);

// Of the whole sets, columns before rows, each axis' finest first; empty where none is whole. kNotFound: no
// black.
[[nodiscard]] Result<std::vector<SetModulation>> MeasureSets(const SessionFrames& frames, const SinusoidPlace& place);

}  // namespace stratalux::fit
