// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/shift_law.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace stratalux::fit {
namespace {

constexpr std::array<const char*, 3> kLaws = {"paper", "refracted", "refracted_sine"};

}  // namespace

const char* ToString(ShiftLaw law) { return kLaws[static_cast<size_t>(law)]; }

Result<ShiftLaw> ParseShiftLaw(const std::string& text) {
  for (size_t i = 0; i < kLaws.size(); ++i)
    if (text == kLaws[i]) return static_cast<ShiftLaw>(i);
  return Status::Usage("shift law '" + text + "' is unknown; allowed: paper, refracted, refracted_sine");
}

double TangentialShift(ShiftLaw law, double slope_along, double slope_across, double eta) {
  if (law == ShiftLaw::kPaper) return slope_along;
  const double slope = std::hypot(slope_along, slope_across);
  if (slope < 1e-12) return 0.0;
  const double sin_t = slope / std::sqrt(1.0 + slope * slope) / eta;
  const double length = law == ShiftLaw::kRefractedSine ? sin_t : sin_t / std::sqrt(1.0 - sin_t * sin_t);
  return length * slope_along / slope;
}

double FresnelTransmission(double cos_in, double eta) {
  const double sin_t = std::sqrt(std::max(0.0, 1.0 - cos_in * cos_in)) / eta;
  const double cos_t = std::sqrt(1.0 - sin_t * sin_t);
  const double s = (cos_in - eta * cos_t) / (cos_in + eta * cos_t);
  const double p = (eta * cos_in - cos_t) / (eta * cos_in + cos_t);
  return 1.0 - 0.5 * (s * s + p * p);
}

double AngularGain(double cos_in, double eta, double tau) {
  const double sin_t = std::sqrt(std::max(0.0, 1.0 - cos_in * cos_in)) / eta;
  const double sec_t = 1.0 / std::sqrt(1.0 - sin_t * sin_t);
  return FresnelTransmission(cos_in, eta) / FresnelTransmission(1.0, eta) * std::exp(-tau * (sec_t - 1.0));
}

double GainPath(double cos_in, double eta) {
  return -std::log(AngularGain(cos_in, eta, 1.0) / AngularGain(cos_in, eta, 0.0));
}

}  // namespace stratalux::fit
