// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/mixture/textbook_em.h"

#include <cmath>
#include <numbers>
#include <numeric>

namespace stratalux::bench {

void TextbookEm(const std::vector<double>& photons, double first, double step, int sweeps, fit::LayerSet& layers) {
  const size_t points = photons.size(), count = layers.weight.size();
  const double total = std::accumulate(photons.begin(), photons.end(), 0.0);
  std::vector<double> share(points * count);
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    for (size_t i = 0; i < points; ++i) {
      const double x = first + static_cast<double>(i) * step;
      double sum = 0.0;
      for (size_t l = 0; l < count; ++l) {
        const double z = (x - layers.depth_mm[l]) / layers.sigma_mm[l];
        share[i * count + l] =
            layers.weight[l] * std::exp(-0.5 * z * z) / (layers.sigma_mm[l] * std::sqrt(2.0 * std::numbers::pi));
        sum += share[i * count + l];
      }
      for (size_t l = 0; l < count; ++l) share[i * count + l] *= sum > 0.0 ? photons[i] / sum : 0.0;
    }
    for (size_t l = 0; l < count; ++l) {
      double n = 0.0, mean = 0.0, spread = 0.0;
      for (size_t i = 0; i < points; ++i) {
        n += share[i * count + l];
        mean += share[i * count + l] * (first + static_cast<double>(i) * step);
      }
      if (!(n > 0.0)) continue;
      mean /= n;
      for (size_t i = 0; i < points; ++i) {
        const double x = first + static_cast<double>(i) * step - mean;
        spread += share[i * count + l] * x * x;
      }
      layers.weight[l] = n / total;
      layers.depth_mm[l] = mean;
      layers.sigma_mm[l] = std::sqrt(spread / n + 1e-4);
    }
  }
}

}  // namespace stratalux::bench
