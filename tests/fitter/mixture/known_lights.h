// SPDX-License-Identifier: Apache-2.0
// Comb profiles of known layers under lights of several slopes, with photon noise: the truth that fits are held to.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "fitter/mixture/fit_mixture.h"
#include "shared/base/random.h"

namespace stratalux::fit::test {

// Five layers of skin-like sizes.
inline LayerSet FiveLayers() {
  return {{0.05, 0.10, 0.12, 0.10, 0.08}, {0.05, 0.2, 0.5, 0.9, 1.4}, {0.2, 0.45, 0.9, 1.8, 3.5}};
}

// `profiles` combs of 64 samples of a light of tangent `slope` on a frontal surface, each at its own phase; photon
// noise with `peak_counts` at the brightest sample (0: none).
inline SrdBatch CombOf(const LayerSet& layers, double slope, int64_t profiles, double peak_counts,
                       const EmOptions& options, Random& random) {
  SrdBatch b;
  b.samples = 64;
  b.slope_in.assign(profiles, static_cast<float>(slope));
  for (auto* v : {&b.slope_out, &b.slope_in_across, &b.slope_out_across}) v->assign(profiles, 0.0F);
  b.cos_in.assign(profiles, static_cast<float>(1.0 / std::hypot(1.0, slope)));
  b.cos_out.assign(profiles, 1.0F);
  b.step_mm.assign(profiles, 0.58F);
  b.line_width_mm.assign(profiles, 0.58F);
  b.blur_mm.assign(profiles, 0.18F);
  b.valid.assign(profiles, 1);
  for (int64_t i = 0; i < profiles; ++i) {
    b.first_u_mm.push_back(static_cast<float>(-10.0 + 0.037 * static_cast<double>(i % 40)));
    b.y.resize(b.samples * (i + 1));
    const auto y = PredictSamples(layers, b, i, options.scattering);
    const double counts = peak_counts > 0.0 ? peak_counts / *std::max_element(y.begin(), y.end()) : 1e6;
    for (int k = 0; k < b.samples; ++k) {
      const double noise = peak_counts > 0.0 ? random.Normal() * std::sqrt(y[k] / counts) : 0.0;
      b.y[i * b.samples + k] = static_cast<float>(y[k] + noise);
    }
    b.noise_floor.push_back(static_cast<float>(1e-5 / counts));
    b.noise_slope.push_back(static_cast<float>(1.0 / counts));
  }
  return b;
}

}  // namespace stratalux::fit::test
