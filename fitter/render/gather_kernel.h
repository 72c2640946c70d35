// SPDX-License-Identifier: Apache-2.0
// The inner loop of the renderer: Gaussian-weighted flux of a rectangle of lit blocks, sixteen blocks of a row at a
// time. Internal to fitter/render.
#pragma once

#include <array>

#include "shared/image/image.h"

namespace stratalux::fit {

inline constexpr int kGatherLanes = 16;

// One pyramid level as planes, rows padded by kGatherLanes blocks without flux.
struct LitPlanes {
  int width = 0, height = 0, stride = 0;
  std::vector<float> x, y, z;     // position, mm
  std::vector<float> nx, ny, nz;  // normal
  std::vector<float> spread_mm2;
  std::array<std::vector<float>, 3> flux;
};

struct GatherTarget {
  std::array<float, 3> normal{}, centre_mm{};
  float half_inverse2 = 0.0F;   // 1 / 2 sigma^2
  float max_spread_mm2 = 0.0F;  // blocks that spread wider are left out
  int channel = 0;
};

struct Gathered {
  float sum = 0.0F;
  bool left_out = false;  // some block with flux spreads too wide
};

// Sum over blocks x0 .. x1, y0 .. y1 of flux exp(-|offset in the tangent plane|^2 / 2 sigma^2).
[[nodiscard]] Gathered GatherBlocks(const LitPlanes& planes, int x0, int x1, int y0, int y1,
                                    const GatherTarget& target);

}  // namespace stratalux::fit
