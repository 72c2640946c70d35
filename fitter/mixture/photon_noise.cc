// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/photon_noise.h"

#include <algorithm>

namespace stratalux::fit {

PhotonNoise PhotonNoiseOf(const SrdBatch& batch, int64_t profile) {
  const auto y = batch.Samples(profile), v = batch.Variances(profile);
  const auto [low, high] = std::minmax_element(v.begin(), v.end());
  const double at_low = y[low - v.begin()], dy = y[high - v.begin()] - at_low, dv = double(*high) - *low;
  if (!(dy > 0.0) || !(dv > 0.0)) return {};
  const double per_count = dv / dy;
  return {1.0 / per_count, std::max(0.0, *low / per_count - std::max(0.0, at_low))};
}

}  // namespace stratalux::fit
