// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/skin_albedo.h"

#include <algorithm>
#include <cmath>

#include "shared/units/angle.h"

namespace stratalux::rig {
namespace {

constexpr double kLow = 0.0005, kHigh = 0.3;  // covers both fractions
double Fraction(double step, int steps) { return kLow * std::pow(kHigh / kLow, step / steps); }
float Position(float fraction, int steps) {
  const double p = std::log(std::max<double>(fraction, kLow) / kLow) / std::log(kHigh / kLow) * steps;
  return static_cast<float>(std::clamp(p, 0.0, steps - 1e-3));
}

}  // namespace

SkinAlbedo::SkinAlbedo(const SkinTable& table) {
  for (int c = 0; c < kSkinChannels; ++c)
    for (int m = 0; m <= kSteps; ++m)
      for (int b = 0; b <= kSteps; ++b)
        values_[c][m * (kSteps + 1) + b] = static_cast<float>(table.Albedo(
            c, {static_cast<float>(Fraction(m, kSteps)), static_cast<float>(Fraction(b, kSteps))}, RadFromDeg(30)));
}

float SkinAlbedo::operator()(int channel, const SkinParameters& parameters) const {
  const float m = Position(parameters.melanin, kSteps), b = Position(parameters.blood, kSteps);
  const int i = static_cast<int>(m), j = static_cast<int>(b);
  const float u = m - static_cast<float>(i), v = b - static_cast<float>(j);
  const float* at = values_[channel].data() + i * (kSteps + 1) + j;
  return (1 - u) * ((1 - v) * at[0] + v * at[1]) + u * ((1 - v) * at[kSteps + 1] + v * at[kSteps + 2]);
}

}  // namespace stratalux::rig
