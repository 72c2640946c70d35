// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/solids.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "shared/units/angle.h"

namespace stratalux::rig {

double TiltedPlane::Height(double x, double /*y*/) const { return 700.0 + x * std::tan(RadFromDeg(10.0)); }

double Sphere::Height(double x, double y) const {
  constexpr double kRadius = 80.0;
  const double q = kRadius * kRadius - x * x - y * y;
  return q > 0.0 ? 760.0 - std::sqrt(q) : std::numeric_limits<double>::quiet_NaN();
}

double Bowl::Height(double x, double y) const {
  const double q = kRadiusMm * kRadiusMm - x * x - y * y;
  return 660.0 + std::sqrt(std::max(0.0, q));
}

}  // namespace stratalux::rig
