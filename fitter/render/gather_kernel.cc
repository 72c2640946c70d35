// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/gather_kernel.h"

#include <cstdint>
#include <cstring>

#include "fitter/render/simd.h"

namespace stratalux::fit {

static_assert(kGatherLanes == kLanes);

SLX_SIMD_CLONES Gathered GatherBlocks(const LitPlanes& planes, int x0, int x1, int y0, int y1,
                                      const GatherTarget& target) {
  // Selections are of floats throughout: GCC 12 lowers logic on vector masks lane by lane.
  const Vec none = {};
  Vec sum = none, widest = none, lane = none;
  for (int i = 0; i < kLanes; ++i) lane[i] = static_cast<float>(i);
  for (int y = y0; y <= y1; ++y) {
    const size_t row = static_cast<size_t>(y) * planes.stride;
    for (int x = x0; x <= x1; x += kLanes) {
      const size_t at = row + x;
      Vec flux = Load(planes.flux[target.channel].data() + at);
      flux = lane <= static_cast<float>(x1 - x) ? flux : none;
      if (!Any(flux)) continue;  // most of a stripe's surroundings are dark
      const Vec spread = Load(planes.spread_mm2.data() + at);
      const Vec lit_spread = flux > 0.0F ? spread : none;
      widest = lit_spread > widest ? lit_spread : widest;
      flux = spread > target.max_spread_mm2 ? none : flux;
      const Vec facing = target.normal[0] * Load(planes.nx.data() + at) +
                         target.normal[1] * Load(planes.ny.data() + at) +
                         target.normal[2] * Load(planes.nz.data() + at);
      flux = facing < 0.0F ? none : flux;
      const Vec dx = Load(planes.x.data() + at) - target.centre_mm[0],
                dy = Load(planes.y.data() + at) - target.centre_mm[1],
                dz = Load(planes.z.data() + at) - target.centre_mm[2];
      const Vec along = target.normal[0] * dx + target.normal[1] * dy + target.normal[2] * dz;
      sum += flux * Exp(-target.half_inverse2 * (dx * dx + dy * dy + dz * dz - along * along));
    }
  }
  Gathered gathered;
  for (int i = 0; i < kLanes; ++i) {
    gathered.sum += sum[i];
    gathered.left_out = gathered.left_out || widest[i] > target.max_spread_mm2;
  }
  return gathered;
}

}  // namespace stratalux::fit
