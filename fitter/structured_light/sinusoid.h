// SPDX-License-Identifier: Apache-2.0
// The first harmonic of N shifted sinusoids at one camera site (docs/math/geometry.md, eq. 2).
#pragma once

#include <cmath>
#include <numbers>
#include <span>
#include <vector>

#include "fitter/structured_light/sensor_noise.h"
#include "shared/image/image.h"

namespace stratalux::fit {

//   I_k = mean + amplitude cos(phase - 2 pi k / N),   phase = 2 pi (c + 0.5) / period  (Pattern::kSinusoid)
struct Harmonic {
  double mean_dn = 0.0;  // raw, black level included
  double amplitude_dn = 0.0;
  double phase_rad = 0.0;           // [0, 2 pi)
  double amplitude_sigma_dn = 0.0;  // of each quadrature; phase sigma = this / amplitude
  bool saturated = false;

  // Whether its phase counts: the amplitude exceeds so many standard deviations.
  [[nodiscard]] bool HasPhase(double sigmas) const { return !saturated && amplitude_dn >= sigmas * amplitude_sigma_dn; }
};

// cos and sin of 2 pi k / N, made once a map.
struct ShiftTable {
  explicit ShiftTable(int shifts) : cosine(shifts), sine(shifts) {
    for (int k = 0; k < shifts; ++k) {
      cosine[k] = std::cos(2.0 * std::numbers::pi * k / shifts);
      sine[k] = std::sin(2.0 * std::numbers::pi * k / shifts);
    }
  }
  std::vector<double> cosine, sine;
};

// `site`: offset of the sample in the frames, which all have one channel and one size; N = frames.size() >= 3.
[[nodiscard]] inline Harmonic HarmonicAt(std::span<const ImageView<const uint16_t>> frames, size_t site,
                                         const ShiftTable& table, const SensorNoise& noise) {
  const double n = static_cast<double>(frames.size());
  double sum = 0.0, re = 0.0, im = 0.0;
  Harmonic h;
  for (size_t k = 0; k < frames.size(); ++k) {
    const double value = frames[k].data()[site];
    h.saturated |= value >= noise.saturation_dn;
    sum += value;
    re += value * table.cosine[k];
    im += value * table.sine[k];
  }
  h.mean_dn = sum / n;
  h.amplitude_dn = 2.0 / n * std::hypot(re, im);
  h.phase_rad = std::atan2(im, re);
  if (h.phase_rad < 0.0) h.phase_rad += 2.0 * std::numbers::pi;
  h.amplitude_sigma_dn = std::sqrt(2.0 / n * noise.VarianceDn2(h.mean_dn));
  return h;
}

}  // namespace stratalux::fit
