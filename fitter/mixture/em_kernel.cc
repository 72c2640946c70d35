// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_kernel.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "fitter/mixture/simd.h"

namespace stratalux::fit {
namespace {

// Cells between exact exponentials: at most 32, so that the recurrence's relative error stays below 1e-4, and at most
// six standard deviations of the narrowest lane, so that no peak hides behind a start that underflows.
constexpr int kMinRun = 4, kMaxRun = 32;
constexpr float kReach = 4.7F;  // standard deviations; beyond lie 3e-6 of a layer

// Cells that layer `l` reaches in any lane; empty when no lane has weight.
struct Range {
  int low, high;
  int run;  // cells between exact exponentials
};
inline Range RangeOf(const EmGrid& grid, const float* weight, const float* mean, const float* sigma) {
  float low = 1e9F, high = -1e9F, narrowest = 1e9F;
  for (int i = 0; i < kLanes; ++i) {
    if (!(weight[i] > 0.0F)) continue;
    low = std::min(low, mean[i] - kReach * sigma[i]);
    high = std::max(high, mean[i] + kReach * sigma[i]);
    narrowest = std::min(narrowest, sigma[i]);
  }
  if (low > high) return {0, 0, kMaxRun};
  // Wrapped: the three images nearest; open: the grid.
  const int first = grid.wrapped ? -grid.cells : 0, last = grid.wrapped ? 2 * grid.cells : grid.cells;
  return {std::clamp(static_cast<int>(std::floor(low)), first, last),
          std::clamp(static_cast<int>(std::ceil(high)) + 1, first, last),
          std::clamp(static_cast<int>(6.0F * std::min(narrowest, 100.0F)), kMinRun, kMaxRun)};
}

// Calls run(cell, count, z0): `count` consecutive cells starting at memory cell `cell`, whose first has coordinate z0.
template <typename Run>
inline __attribute__((always_inline)) void ForEachRun(const EmGrid& grid, Range range, const Run& run) {
  int z = range.low;
  while (z < range.high) {
    const int cell = grid.wrapped ? (z % grid.cells + grid.cells) % grid.cells : z;
    const int count = std::min({range.run, range.high - z, grid.cells - cell});
    run(cell, count, static_cast<float>(z));
    z += count;
  }
}

}  // namespace

SLX_SIMD_CLONES
void AddLayers(const EmGrid& grid, int layers, const float* weight, const float* mean, const float* sigma,
               float* mass) {
  for (int l = 0; l < layers; ++l, weight += kLanes, mean += kLanes, sigma += kLanes) {
    const Range range = RangeOf(grid, weight, mean, sigma);
    const Vec mu = Load(mean), inverse = 1.0F / Load(sigma);
    const Vec height = Load(weight) * inverse * 0.398942280F;
    const Vec curvature = inverse * inverse;
    const Vec ratio = Exp(-curvature);  // of successive ratios
    ForEachRun(
        grid, range, [&](int cell, int count, float z0) __attribute__((always_inline)) {
          // N(z + 1) / N(z) = exp(-((z - mu) + 1/2) / sigma^2), itself falling by exp(-1 / sigma^2) a cell.
          const Vec z = z0 - mu;
          Vec g = height * Exp(-0.5F * curvature * z * z);
          Vec r = Exp(-curvature * (z + 0.5F));
          float* m = mass + cell * kLanes;
          for (int j = 0; j < count; ++j, m += kLanes) {
            Store(m, Load(m) + g);
            g *= r;
            r *= ratio;
          }
        });
  }
}

SLX_SIMD_CLONES
void LayerMoments(const EmGrid& grid, int layers, const float* weight, const float* mean, const float* sigma,
                  const float* q, float* moments) {
  for (int l = 0; l < layers; ++l, weight += kLanes, mean += kLanes, sigma += kLanes, moments += 3 * kLanes) {
    const Range range = RangeOf(grid, weight, mean, sigma);
    const Vec mu = Load(mean), inverse = 1.0F / Load(sigma);
    const Vec height = Load(weight) * inverse * 0.398942280F;
    const Vec curvature = inverse * inverse;
    const Vec ratio = Exp(-curvature);
    Vec s0 = {}, s1 = {}, s2 = {};
    ForEachRun(
        grid, range, [&](int cell, int count, float z0) __attribute__((always_inline)) {
          Vec z = z0 - mu;
          Vec g = height * Exp(-0.5F * curvature * z * z);
          Vec r = Exp(-curvature * (z + 0.5F));
          const float* ratio_at = q + cell * kLanes;
          for (int j = 0; j < count; ++j, ratio_at += kLanes) {
            const Vec c = g * Load(ratio_at);
            const Vec cz = c * z;
            s0 += c;
            s1 += cz;
            s2 += cz * z;
            z += 1.0F;
            g *= r;
            r *= ratio;
          }
        });
    Store(moments, s0);
    Store(moments + kLanes, s1);
    Store(moments + 2 * kLanes, s2);
  }
}

}  // namespace stratalux::fit
