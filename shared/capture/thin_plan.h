// SPDX-License-Identifier: Apache-2.0
// Which frames of a visit a fit can do with: subsets of a plan, the most redundant left out first
// (docs/capture-plan.md, "Fewer frames").
#pragma once

#include <string>
#include <vector>

#include "shared/capture/plan.h"

namespace stratalux {

struct ThinPlan {
  int asked = 0;          // frames at most
  int whole = 0;          // steps of the plan
  std::vector<int> kept;  // PlanStep::index, rising: all that the stages of a fit may read
  // Steps beside them that a comparison with held-out light reads, and no stage of a fit: second takes, spots, whites
  // of the motion check and the first comb, where they are not kept.
  int evaluation_only = 0;
  int comb_every = 1;   // one comb in so many of a cycle is kept, the first one first
  bool columns = true;  // codes of columns are kept: a surface can be reconstructed
  bool row_sweep = false;
  std::vector<PatternAxis> sinusoids = {PatternAxis::kColumns, PatternAxis::kRows};  // axes of those that are kept
  std::vector<std::string> left_out;  // for people, each with numbers a projector, such as "combs: 48 of 64"
  [[nodiscard]] bool IsWhole() const { return static_cast<int>(kept.size()) == whole; }
};

// At most `frames` steps of a visitor's plan, as many of every projector. In this order, while they fit: white, black
// and a few combs (they have no substitute), more combs, sinusoids along columns, codes of columns, combs again, then
// what measures once more: sinusoids along rows, inverse codes, codes of rows, a sweep over rows, further exposures.
// What room is left goes to blacks and whites, by turns. Never kept but in the whole plan: what no stage of a fit
// reads. kUsage: less than white, black and the fewest combs of each projector; another kind of session.
[[nodiscard]] Result<ThinPlan> ThinTo(const CapturePlan& plan, int frames);

// One line for people: how many are kept, and what is left out of each projector's.
[[nodiscard]] std::string Describe(const ThinPlan& thin);

// The fewest frames with which a surface can be reconstructed.
[[nodiscard]] int LeastForSurface(const CapturePlan& plan);

}  // namespace stratalux
