// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/gather_kernel.h"

#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "tests/fitter/mixture/simd_targets.h"

namespace stratalux::fit {
namespace {

constexpr int kWidth = 75, kHeight = 5;

// Lit blocks of all kinds: dark ones, those that spread too wide, those that face away.
LitPlanes Blocks(uint64_t seed) {
  Random random(seed);
  LitPlanes planes;
  planes.width = kWidth;
  planes.height = kHeight;
  planes.stride = kWidth + kGatherLanes;
  const size_t size = static_cast<size_t>(planes.stride) * kHeight;
  for (auto* plane : {&planes.x, &planes.y, &planes.z, &planes.nx, &planes.ny, &planes.nz, &planes.spread_mm2,
                      &planes.flux[0], &planes.flux[1], &planes.flux[2]})
    plane->assign(size, 0.0F);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const size_t at = static_cast<size_t>(y) * planes.stride + x;
      planes.x[at] = static_cast<float>(0.3 * x + random.Uniform(-0.1, 0.1));
      planes.y[at] = static_cast<float>(0.3 * y + random.Uniform(-0.1, 0.1));
      planes.z[at] = static_cast<float>(random.Uniform(-0.2, 0.2));
      planes.nz[at] = random.Uniform() < 0.1 ? 1.0F : -1.0F;
      planes.spread_mm2[at] = static_cast<float>(random.Uniform(0.0, 1.0));
      if (random.Uniform() < 0.7) planes.flux[1][at] = static_cast<float>(random.Uniform(0.0, 2.0));
    }
  return planes;
}

// Columns x0 .. x1 of the first rows in plain double precision.
double Reference(const LitPlanes& planes, int x0, int x1, const GatherTarget& target) {
  double sum = 0.0;
  for (int y = 0; y < kHeight; ++y)
    for (int x = x0; x <= x1; ++x) {
      const size_t at = static_cast<size_t>(y) * planes.stride + x;
      const double d[3] = {double(planes.x[at]) - target.centre_mm[0], double(planes.y[at]) - target.centre_mm[1],
                           double(planes.z[at]) - target.centre_mm[2]};
      double along = 0.0, square = 0.0;
      for (size_t k = 0; k < 3; ++k) {
        along += d[k] * target.normal[k];
        square += d[k] * d[k];
      }
      if (planes.spread_mm2[at] > target.max_spread_mm2 || planes.nz[at] * target.normal[2] < 0.0F) continue;
      sum += planes.flux[1][at] * std::exp(-target.half_inverse2 * (square - along * along));
    }
  return sum;
}

TEST(GatherBlocks, IsThePlainSumOnEveryInstructionSet) {
  const LitPlanes planes = Blocks(1);
  GatherTarget target{{0.0F, 0.6F, -0.8F}, {9.0F, 0.7F, 0.05F}, 0.0F, 0.9F, 1};
  for (const float sigma : {0.05F, 0.4F, 3.0F}) {
    target.half_inverse2 = 0.5F / (sigma * sigma);
    for (const auto& [x0, x1] : {std::pair(0, kWidth - 1), {20, 20}, {13, 47}, {60, kWidth - 1}}) {
      const double reference = Reference(planes, x0, x1, target);
      ForEachSimdTarget([&, first = x0, last = x1](const char* name) {
        const Gathered gathered = GatherBlocks(planes, first, last, 0, kHeight - 1, target);
        EXPECT_NEAR(gathered.sum, reference, 3e-6 * reference + 1e-30) << name << " " << sigma << " " << first;
      });
    }
  }
  EXPECT_TRUE(GatherBlocks(planes, 0, kWidth - 1, 0, kHeight - 1, target).left_out);
  target.max_spread_mm2 = 1.0F;
  EXPECT_FALSE(GatherBlocks(planes, 0, kWidth - 1, 0, kHeight - 1, target).left_out);
}

}  // namespace
}  // namespace stratalux::fit
