// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/pattern_score.h"

#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

// Probes at known projector pixels that see a pattern blurred by an exponential of `decay_px`, half of it everywhere.
struct Seen {
  std::vector<float> level;
  std::vector<int> column, row;
  [[nodiscard]] LevelsAt At() const { return {level, column, row, 256, 128}; }
};

Seen See(const Pattern& pattern, double decay_px, double noise, uint64_t seed, int probes = 4000) {
  Random random(seed);
  Seen seen;
  double norm = 0.0;
  for (int d = -40; d <= 40; ++d) norm += std::exp(-std::abs(d) / decay_px);
  for (int i = 0; i < probes; ++i) {
    const int c = static_cast<int>(random.Uniform() * 256), r = static_cast<int>(random.Uniform() * 128);
    double level = 0.0;
    for (int d = -40; d <= 40; ++d)
      level += std::exp(-std::abs(d) / decay_px) / norm *
               (pattern.axis == PatternAxis::kColumns ? pattern.Intensity(c + d, r) : pattern.Intensity(c, r + d));
    seen.level.push_back(static_cast<float>(level + noise * random.Normal()));
    seen.column.push_back(c);
    seen.row.push_back(r);
  }
  return seen;
}

TEST(CombEvidence, TheOwnShiftWinsThroughAnyBlur) {
  for (const double decay : {0.5, 2.0, 6.0}) {
    const Pattern comb = {.kind = PatternKind::kComb, .period = 64, .width = 2, .shift = 20};
    EXPECT_GT(CombEvidence(comb, 2, See(comb, decay, 0.02, 3).At()), 5.0) << decay;
  }
}

TEST(CombEvidence, EveryOtherShiftLosesTheNeighboursToo) {
  const Pattern planned = {.kind = PatternKind::kComb, .period = 64, .width = 2, .shift = 20};
  for (int shift = 0; shift < 64; shift += 2) {
    if (shift == planned.shift) continue;
    Pattern shown = planned;
    shown.shift = shift;
    EXPECT_LT(CombEvidence(planned, 2, See(shown, 2.0, 0.02, 4).At()), -5.0) << shift;
  }
}

TEST(CombEvidence, NoiseAloneIsSilent) {
  const Pattern comb = {.kind = PatternKind::kComb, .period = 64, .width = 2, .shift = 20};
  for (uint64_t seed = 0; seed < 20; ++seed)
    EXPECT_LT(CombEvidence(comb, 2, See({.kind = PatternKind::kBlack}, 2.0, 0.02, seed).At()), 4.0) << seed;
}

TEST(ShiftEvidence, SinusoidsAndCheckerboardsKnowTheirShift) {
  for (const PatternKind kind : {PatternKind::kSinusoid, PatternKind::kCheckerboard}) {
    const Pattern planned = {.kind = kind, .period = 8, .shift = 1, .shifts = kind == PatternKind::kSinusoid ? 4 : 2};
    EXPECT_GT(ShiftEvidence(planned, See(planned, 1.0, 0.02, 5).At()), 5.0);
    for (const int shift : {0, 2, 3}) {
      // Moved by half a period along rows instead of columns, the checkerboard is the same picture.
      if (kind == PatternKind::kCheckerboard && shift == 2) continue;
      Pattern shown = planned;
      shown.shift = shift;
      EXPECT_LT(ShiftEvidence(planned, See(shown, 1.0, 0.02, 6).At()), -5.0) << shift;
    }
  }
}

TEST(ShiftEvidence, WithoutCoordinatesItIsSilent) {
  EXPECT_EQ(ShiftEvidence({.kind = PatternKind::kSinusoid, .period = 8, .shifts = 4}, {}), 0.0);
}

}  // namespace
}  // namespace stratalux::rig
