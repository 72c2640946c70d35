// SPDX-License-Identifier: Apache-2.0
// Which shift of a pattern does a frame show? Evidence for the planned shift against each other one.
#pragma once

#include <span>
#include <vector>

#include "shared/pattern/pattern.h"

namespace stratalux::rig {

// A frame at the probes of which the projector coordinates are known.
struct LevelsAt {
  std::span<const float> level;  // (I - B) / (W - B)
  std::span<const int> column;   // projector pixel; -1: unknown, or not needed for the pattern
  std::span<const int> row;
  int width = 0;  // of the projector, px
  int height = 0;
};

// Weakest evidence, in standard deviations: how much better the frame agrees with the planned pattern than with the
// candidate that fits best among the others. > 0: the planned one fits best. 0 where nothing can be told.
// The deviation is the empirical one, so uneven skin and decoding errors count as noise.

// A comb whose lines move by `step` px from shift to shift, against all other shifts of its period.
// Evidence is the level near the lines: the pattern's light falls off to both sides of a line, whatever scatters it.
[[nodiscard]] double CombEvidence(const Pattern& comb, int step, const LevelsAt& frame);
// A sinusoid or a checkerboard against its other shifts.
[[nodiscard]] double ShiftEvidence(const Pattern& pattern, const LevelsAt& frame);

}  // namespace stratalux::rig
