// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "shared/image/image.h"

namespace stratalux::fit {

// A map on quads, W x H x C, of one with a value for `pool` x `pool` of them; NaN behind its last.
[[nodiscard]] Image<float> OnQuads(ImageView<const float> pooled, int pool, int width, int height);

}  // namespace stratalux::fit
