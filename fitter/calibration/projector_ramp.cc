// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/projector_ramp.h"

#include <algorithm>
#include <cmath>

#include "fitter/calibration/monotone.h"

namespace stratalux::fit {
namespace {

// Of white at a step, between the whites before and after it.
double WhiteAt(const std::vector<RampFrame>& whites, int step) {
  const auto after = std::find_if(whites.begin(), whites.end(), [&](const RampFrame& w) { return w.step >= step; });
  if (after == whites.end()) return whites.back().light;
  if (after == whites.begin()) return after->light;
  const RampFrame& before = *(after - 1);
  const double share = static_cast<double>(step - before.step) / (after->step - before.step);
  return before.light + share * (after->light - before.light);
}

}  // namespace

Result<ProjectorRamp> FitProjectorRamp(const std::vector<RampFrame>& frames) {
  std::vector<RampFrame> whites, levels;
  for (const RampFrame& f : frames) (f.grey >= 1.0 ? whites : levels).push_back(f);
  if (whites.empty() || !(whites.front().light > 0.0)) return Status::Failed("the grey ramp has no white");
  std::sort(levels.begin(), levels.end(), [](const auto& a, const auto& b) { return a.grey < b.grey; });
  const auto steps = static_cast<double>(levels.size() + 1);
  ProjectorRamp ramp;
  std::vector<double> curve{0.0};
  for (size_t k = 0; k < levels.size(); ++k) {
    if (std::abs(levels[k].grey - static_cast<double>(k + 1) / steps) > 1e-6)
      return Status::Failed("grey level " + std::to_string(k + 1) + " of the ramp is missing");
    curve.push_back(levels[k].light / WhiteAt(whites, levels[k].step));
  }
  if (curve.size() < 8) return Status::Failed("the grey ramp has " + std::to_string(levels.size()) + " levels only");
  curve.push_back(1.0);
  for (const RampFrame& w : whites)
    ramp.lamp_drift = std::max(ramp.lamp_drift, std::abs(w.light / whites.front().light - 1.0));
  double highest = 0.0;
  for (const double v : curve) {
    highest = std::max(highest, v);
    ramp.worst_fall = std::max(ramp.worst_fall, highest - v);
  }
  ramp.response = MonotoneFrom(curve);
  for (double& v : ramp.response) v = std::clamp(v, 0.0, 1.0);
  ramp.response.front() = 0.0;
  ramp.response.back() = 1.0;
  for (size_t k = 0; k < ramp.response.size(); ++k)
    ramp.largest_deviation =
        std::max(ramp.largest_deviation, std::abs(ramp.response[k] - static_cast<double>(k) / steps));
  return ramp;
}

}  // namespace stratalux::fit
