// SPDX-License-Identifier: Apache-2.0
// The light that a fit is compared with, taken several times: what it is, and what noise is left in that.
//
// Takes y_1 .. y_n, n even, of one light t, in the order of the plan: y_k = t + e_k with noise e_k of variance v,
// independent of each other. Then                                        docs/math/evaluation.md, eq. (1) and (2)
//   target = sum_k y_k / n   and   noise = (sum_{k <= n/2} y_k - sum_{k > n/2} y_k) / n
// carry noise of variance v / n each, independent of each other: of two takes their mean and half their difference.
#pragma once

#include <string>
#include <vector>

#include "fitter/session/session_frames.h"

namespace stratalux::fit {

// "stripe": the sweep's first comb; "spot"; else white. Of `plan`, on the projector.
[[nodiscard]] Pattern HeldOutPattern(const std::string& light, const PlanOptions& plan);
// In which it was taken first.
[[nodiscard]] CapturePhase HeldOutPhase(const std::string& light);
// The last good shot of each step that shows the light at its exposure, in the order of the steps.
[[nodiscard]] std::vector<const db::FrameRow*> HeldOutTakesOf(const SessionFrames& frames, int projector,
                                                              const std::string& light);

// Its exposure over the nominal one: phases of several exposures begin with their first, a sweep's need not be 1.
[[nodiscard]] double HeldOutFactor(const std::string& light, const PlanOptions& plan);
// The mean black frame of that exposure.
[[nodiscard]] Result<Image<float>> HeldOutBlack(const SessionFrames& frames, int projector, const std::string& light);

struct HeldOutTarget {
  // Quads, digital numbers above the mean black frame, as if at the nominal exposure; NaN where a take is saturated.
  Image<float> target;
  Image<float> noise;  // of `target`, same shape; without that of the black frame, which all takes share
  int takes = 0;
};

// Stripe and spot: both takes; white: the motion whites (of an odd number all but the middle one). kNotFound where the
// session has less than two good ones: it is older than second takes, or lost them.
[[nodiscard]] Result<HeldOutTarget> ReadHeldOutTarget(const SessionFrames& frames, int projector,
                                                      const std::string& light);

}  // namespace stratalux::fit
