// SPDX-License-Identifier: Apache-2.0
// Gray code frames against their inverses: light is additive, hence pattern + inverse = white + black in every pixel,
// whatever skin, ambient light and interreflection do. What does not add up is a frame of another pattern, a visitor
// who moved, or a lamp that drifted.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

// Reads pixels of one of the frames; the caller decides from where.
using FrameLoader = std::function<Result<Image<uint16_t>>(const FrameRow&)>;

// One pair a projector and axis, out of the coarser bits (stripes wider than the blocks below): at most 32 frames are
// decoded. Means of blocks of 8 x 8 pixels are compared, which brings the noise of a pixel (some 20 DN) to about 3 DN;
// a pair fails where more than 3 % of the blocks are off by more than 8 DN + 6 % of white - black. Saturated blocks are
// left out. Each result names projector, pattern and share of blocks. Empty: all add up, or there are no pairs.
[[nodiscard]] std::vector<std::string> CheckComplementaryPairs(const std::vector<FrameRow>& frames,
                                                               const FrameLoader& load);

}  // namespace stratalux::db
