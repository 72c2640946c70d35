// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_pace.h"

#include <algorithm>
#include <cmath>

namespace stratalux::fit {
namespace {

// A divergence this much (relative) above the best is single precision's noise, not a step too far.
constexpr double kNoise = 1e-5;
constexpr int kCheckEvery = 8;

}  // namespace

LaneStep EmPace::Judge(double now, double tolerance, bool accelerated, int most_sweeps, float& momentum) {
  ++sweeps;
  momentum = 0.0F;
  LaneStep step = kAdvance;
  if (!accelerated || now <= best * (1.0 + kNoise)) {
    const double next = 0.5 * (1.0 + std::sqrt(1.0 + 4.0 * t * t));
    if (accelerated) momentum = static_cast<float>((t - 1.0) / next);
    t = next;
  } else {
    t = 1.0;
    step = kReturn;
  }
  best = std::min(best, now);
  bool settled = false;
  if (sweeps % kCheckEvery == 0) {
    settled = std::isfinite(checked) && checked - best <= tolerance * kCheckEvery * checked;
    checked = best;
  }
  last = settled || sweeps >= most_sweeps;
  if (last) momentum = 0.0F;
  return step;
}

}  // namespace stratalux::fit
