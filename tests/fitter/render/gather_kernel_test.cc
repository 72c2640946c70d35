// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/gather_kernel.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "tests/fitter/mixture/simd_targets.h"

namespace stratalux::fit {
namespace {

constexpr int kWidth = 75, kHeight = 9;

// Lit blocks of all kinds: dark ones, those that spread wide, those that face away.
LitPlanes Blocks(uint64_t seed) {
  Random random(seed);
  LitPlanes planes;
  planes.width = kWidth;
  planes.height = kHeight;
  planes.stride = kWidth + kGatherLanes;
  const size_t size = static_cast<size_t>(planes.stride) * kHeight;
  for (auto* plane :
       {&planes.x, &planes.y, &planes.z, &planes.nx, &planes.ny, &planes.nz, &planes.spread_mm2, &planes.flux})
    plane->assign(size, 0.0F);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const size_t at = static_cast<size_t>(y) * planes.stride + x;
      planes.x[at] = static_cast<float>(0.3 * x + random.Uniform(-0.1, 0.1));
      planes.y[at] = static_cast<float>(0.3 * y + random.Uniform(-0.1, 0.1));
      planes.z[at] = static_cast<float>(500.0 + random.Uniform(-0.2, 0.2));
      planes.nz[at] = random.Uniform() < 0.1 ? 1.0F : -1.0F;
      planes.spread_mm2[at] = static_cast<float>(random.Uniform(0.0, 1.0));
      if (random.Uniform() < 0.7) planes.flux[at] = static_cast<float>(random.Uniform(0.5, 2.0));
    }
  return planes;
}

// A place of the skin: normal (0, 0.6, -0.8), its plane's origin off the Gaussian's centre.
const TangentPlane kPlane = {{8.0F, 1.0F, 500.1F}, {0.0F, 0.6F, -0.8F}, {1.0F, 0.0F, 0.0F}, {0.0F, 0.8F, 0.6F}};

constexpr float kNoLimit = std::numeric_limits<float>::infinity();

// The blocks of a window in plain double precision.
double Reference(const LitPlanes& planes, const BlockWindow& window, float max_spread_mm2, const GatherTarget& target) {
  double sum = 0.0;
  for (int y = window.y0; y <= window.y1; ++y)
    for (int x = window.x0; x <= window.x1; ++x) {
      const size_t at = static_cast<size_t>(y) * planes.stride + x;
      const double d[3] = {double(planes.x[at]) - kPlane.origin_mm[0], double(planes.y[at]) - kPlane.origin_mm[1],
                           double(planes.z[at]) - kPlane.origin_mm[2]};
      double p = -target.p_mm, q = -target.q_mm, off = 0.0;
      for (size_t k = 0; k < 3; ++k) {
        p += d[k] * kPlane.p[k];
        q += d[k] * kPlane.q[k];
        off += d[k] * kPlane.normal[k];
      }
      if (planes.spread_mm2[at] > max_spread_mm2 || planes.nz[at] * kPlane.normal[2] < 0.0F) continue;
      sum += planes.flux[at] * std::exp(-target.half_inverse2 * (p * p + q * q + off * off));
    }
  return sum;
}

constexpr BlockWindow kAll = {0, kWidth - 1, 0, kHeight - 1};

TEST(GatherBlocks, IsThePlainSumOnEveryInstructionSet) {
  const LitPlanes planes = Blocks(1);
  for (const float spread : {0.6F, 1.0F})
    for (const float sigma : {0.1F, 0.4F, 3.0F}) {
      const GatherTarget target{1.1F, -0.4F, 0.5F / (sigma * sigma)};
      for (const BlockWindow& window : {kAll, BlockWindow{30, 30, 2, 2}, {13, 47, 1, 6}, {60, kWidth - 1, 0, 8}}) {
        const double reference = Reference(planes, window, spread, target);
        ForEachSimdTarget([&](const char* name) {
          for (const BlockWindow& seen_window : {window, kAll}) {
            SeenBlocks seen;
            SeeBlocks(planes, seen_window, kPlane, spread, seen);
            // Positions near 500 mm are known to 3e-5 mm.
            const double tolerance = (3e-6 + 1e-4 / sigma * 0.1) * reference + 1e-30;
            EXPECT_NEAR(GatherBlocks(seen, window, target), reference, tolerance)
                << name << ", sigma " << sigma << ", from column " << window.x0;
          }
        });
      }
    }
}

TEST(GatherBlocks, TakesItsExponentialToTheBoundInTheCode) {
  // One block of flux 1 at a known distance: the kernel's e^-x itself.
  LitPlanes planes;
  planes.width = planes.height = 1;
  planes.stride = 1 + kGatherLanes;
  for (auto* plane :
       {&planes.x, &planes.y, &planes.z, &planes.nx, &planes.ny, &planes.nz, &planes.spread_mm2, &planes.flux})
    plane->assign(planes.stride, 0.0F);
  planes.nz[0] = -1.0F;
  planes.flux[0] = 1.0F;
  const TangentPlane plane = {{0.0F, 0.0F, 0.0F}, {0.0F, 0.0F, -1.0F}, {1.0F, 0.0F, 0.0F}, {0.0F, 1.0F, 0.0F}};
  ForEachSimdTarget([&](const char* name) {
    SeenBlocks seen;
    double worst = 0.0;
    for (int k = 0; k <= 2000; ++k) {
      planes.x[0] = static_cast<float>(k) / 256.0F;  // squares are exact
      SeeBlocks(planes, {0, 0, 0, 0}, plane, kNoLimit, seen);
      const double x = double{planes.x[0]};
      const double exact = std::exp(-0.5 * x * x), gathered = GatherBlocks(seen, {0, 0, 0, 0}, {0.0F, 0.0F, 0.5F});
      // The slope log2(e) / 2 is rounded as well: half a unit in the last place of the exponent.
      worst = std::max(worst, std::abs(gathered / exact - 1.0) - 6e-8 * 0.5 * x * x);
    }
    // And the last steps of the polynomial round; two to a step where nothing multiplies and adds at once.
    EXPECT_LT(worst, 1.5e-7 + 3 * 6e-8) << name;
  });
}

TEST(GatherBlocks, VanishesFarAwayAndKnowsNoOverflow) {
  const LitPlanes planes = Blocks(2);
  SeenBlocks seen;
  SeeBlocks(planes, kAll, kPlane, kNoLimit, seen);
  EXPECT_LT(GatherBlocks(seen, kAll, {1e4F, 0.0F, 5.0F}), 1e-30F);
}

TEST(GatherBlocks, TakesPartsAsItTakesBlocks) {
  // However many parts there are, and though blocks' parts lie in no window.
  const LitPlanes planes = Blocks(4);
  const GatherTarget target{1.1F, -0.4F, 0.3F};
  ForEachSimdTarget([&](const char* name) {
    for (const int parts : {1, 15, 16, 17, 40}) {
      SeenBlocks seen;
      SeeBlocks(planes, kAll, kPlane, 0.5F, seen);
      double expected = Reference(planes, kAll, 0.5F, target);
      Random random(static_cast<uint64_t>(parts));
      for (int k = 0; k < parts; ++k) {
        const auto p = static_cast<float>(random.Uniform(-3.0, 3.0)), q = static_cast<float>(random.Uniform(-3.0, 3.0)),
                   off = static_cast<float>(random.Uniform(-1.0, 1.0)),
                   flux = static_cast<float>(random.Uniform(0.5, 2.0));
        seen.AddPart(p, q, off, flux);
        expected += flux * std::exp(-0.3 * (std::pow(p - 1.1, 2) + std::pow(q + 0.4, 2) + off * off));
      }
      seen.EndParts();
      EXPECT_NEAR(GatherBlocks(seen, kAll, target), expected, 2e-5 * expected) << name << ", " << parts << " parts";
      SeeBlocks(planes, kAll, kPlane, 0.5F, seen);
      EXPECT_TRUE(seen.part_flux.empty());  // another look
    }
  });
}

TEST(SeeBlocks, KnowsWhetherAnythingIsLit) {
  LitPlanes planes = Blocks(3);
  SeenBlocks seen;
  const BlockWindow window = {10, 40, 2, 7};
  for (const float limit : {0.0F, kNoLimit}) {  // 0: every block is left to its parts, and still there is light
    SeeBlocks(planes, window, kPlane, limit, seen);
    EXPECT_FALSE(seen.dark);
  }
  for (int y = window.y0; y <= window.y1; ++y)
    for (int x = window.x0; x <= window.x1; ++x) planes.flux[static_cast<size_t>(y) * planes.stride + x] = 0.0F;
  SeeBlocks(planes, window, kPlane, kNoLimit, seen);
  EXPECT_TRUE(seen.dark);
}

TEST(SeeBlocks, ListsWideBlocksInTheirOrderOnEveryInstructionSet) {
  const LitPlanes planes = Blocks(2);
  for (const float limit : {0.0F, 0.6F, 0.99F, 1.0F})
    for (const BlockWindow& window : {kAll, BlockWindow{30, 30, 2, 2}, {13, 47, 1, 6}, {60, kWidth - 1, 0, 8}}) {
      std::vector<BlockPlace> expected;
      for (int y = window.y0; y <= window.y1; ++y)
        for (int x = window.x0; x <= window.x1; ++x) {
          const size_t at = static_cast<size_t>(y) * planes.stride + x;
          if (planes.flux[at] > 0.0F && planes.spread_mm2[at] > limit) expected.push_back({x, y});
        }
      ForEachSimdTarget([&](const char* name) {
        SeenBlocks seen;
        seen.wide.resize(3);
        SeeBlocks(planes, window, kPlane, limit, seen);
        EXPECT_EQ(seen.wide, expected) << name << ", limit " << limit << ", from column " << window.x0;
      });
    }
}

}  // namespace
}  // namespace stratalux::fit
