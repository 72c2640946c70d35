// SPDX-License-Identifier: Apache-2.0
// Which blocks of a window are too wide to be gathered as they are. Internal to fitter/render.
#pragma once

#include <vector>

#include "fitter/render/gather_kernel.h"

namespace stratalux::fit {

struct BlockPlace {
  int x = 0, y = 0;
  [[nodiscard]] friend bool operator==(const BlockPlace&, const BlockPlace&) = default;
};

// Blocks of a window, which `seen` must hold, that spread wider than `max_spread_mm2`, row by row. `wide`'s memory is
// kept from call to call.
void FindWideBlocks(const SeenBlocks& seen, const BlockWindow& window, float max_spread_mm2,
                    std::vector<BlockPlace>& wide);

}  // namespace stratalux::fit
