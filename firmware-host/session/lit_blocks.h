// SPDX-License-Identifier: Apache-2.0
// Where a projector's light meets something: by one white and one black frame of it.
#pragma once

#include <cstdint>
#include <vector>

#include "shared/image/image.h"

namespace stratalux::rig {

inline constexpr int kLitBlock = 8;  // px of the mosaic, so that a block has all colours
inline constexpr double kQuadSamples = 4.0;

// Raw mosaics of one projector, of the same exposure and size.
struct PreScan {
  const Image<uint16_t>& white;
  const Image<uint16_t>& black;
};

struct LitBlock {
  int x = 0, y = 0;     // its left upper pixel
  float signal = 0.0F;  // of a quad (2x2 samples together), white minus black, mean over the block, DN
};

// Blocks with a tenth and more of the signal that the brightest tenth has. `read_noise_dn`: standard deviation of a
// sample; what six of it could be is no light. Row by row; empty where fewer than 16 blocks have light.
[[nodiscard]] std::vector<LitBlock> LitBlocks(const PreScan& scan, double read_noise_dn);

}  // namespace stratalux::rig
