// SPDX-License-Identifier: Apache-2.0
// Direct and global components of one projector, on quads, digital numbers above black (model section 4).
#pragma once

#include <cstdint>

#include "shared/image/image.h"

namespace stratalux::fit {

enum class SeparationReason : uint8_t { kValid = 0, kUnlit = 1, kSaturated = 2, kNegative = 3, kNotTold = 4 };

struct SeparationMap {
  Image<float> direct;           // W x H x C; NaN where invalid, but where kUnlit: there noise may be most of it
  Image<float> global;           // W x H x C; NaN where invalid
  Image<float> direct_variance;  // W x H x C, of its noise; NaN where `direct` is
  Image<float> white;            // W x H x C, all columns on, ambient removed
  Image<uint8_t> reason;         // W x H, SeparationReason; kUnlit: too dark in some colour
};

// `direct` where it is valid in all colours, else NaN.
[[nodiscard]] Image<float> ValidDirect(const SeparationMap& map);

}  // namespace stratalux::fit
