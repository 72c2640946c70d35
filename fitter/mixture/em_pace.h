// SPDX-License-Identifier: Apache-2.0
// Nesterov's momentum with restart over sweeps of EM, and when they end. Internal to fitter/mixture.
#pragma once

#include <limits>

#include "fitter/mixture/em_update.h"

namespace stratalux::fit {

struct EmPace {
  int sweeps = 0;
  bool last = false;  // that sweep ends it
  double best = std::numeric_limits<double>::infinity(), checked = best;
  double t = 1.0;  // Nesterov's

  // What becomes of the sweep just made, whose start had the relative divergence `now`, and by how much the next one
  // goes on; settled where a sweep gains less than `tolerance` of the divergence. A point whose divergence lies above
  // the best is left for the last plain result (whose divergence is at most that of the point it came from): EM never
  // loses likelihood.
  LaneStep Judge(double now, double tolerance, bool accelerated, int most_sweeps, float& momentum);
};

}  // namespace stratalux::fit
