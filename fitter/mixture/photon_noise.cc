// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/photon_noise.h"

#include <algorithm>

namespace stratalux::fit {

PhotonNoise PhotonNoiseOf(const SrdBatch& batch, int64_t profile) {
  const float* y = batch.y.data() + profile * batch.samples;
  const float* v = batch.variance.data() + profile * batch.samples;
  const auto [low, high] = std::minmax_element(v, v + batch.samples);
  const double dy = double(y[high - v]) - y[low - v], dv = double(*high) - *low;
  if (!(dy > 0.0) || !(dv > 0.0)) return {};
  const double per_count = dv / dy;
  return {1.0 / per_count, std::max(0.0, *low / per_count - std::max(0.0F, y[low - v]))};
}

}  // namespace stratalux::fit
