// SPDX-License-Identifier: Apache-2.0
// Isotonic regression: the rising curve nearest to a measured one.
#pragma once

#include <vector>

namespace stratalux::fit {

// Least squares with equal weights under y_0 <= y_1 <= ..., by pooling adjacent violators (Ayer et al. 1955).
[[nodiscard]] inline std::vector<double> MonotoneFrom(const std::vector<double>& values) {
  struct Pool {
    double sum;
    int count;
  };
  std::vector<Pool> pools;
  for (const double value : values) {
    pools.push_back({value, 1});
    while (pools.size() > 1) {
      const Pool last = pools.back();
      Pool& before = pools[pools.size() - 2];
      if (before.sum * last.count <= last.sum * before.count) break;
      before = {before.sum + last.sum, before.count + last.count};
      pools.pop_back();
    }
  }
  std::vector<double> rising;
  for (const Pool& pool : pools) rising.insert(rising.end(), static_cast<size_t>(pool.count), pool.sum / pool.count);
  return rising;
}

}  // namespace stratalux::fit
