// SPDX-License-Identifier: Apache-2.0
// Maps that were captured at one moment, on the quads of another: what lay at `places(i, j)` (W x H x 2, in quads; NaN:
// nowhere) comes to quad (i, j) (docs/math/motion.md, "Carried").
#pragma once

#include <cstdint>
#include <vector>

#include "fitter/separation/separation_map.h"
#include "fitter/structured_light/decoded_map.h"
#include "shared/image/image.h"
#include "shared/image/pixel_format.h"

namespace stratalux::fit {

// Between four sites that are decoded, and alike enough to be of one surface, in proportion; else the nearest one's.
// Sigmas are not lowered: neighbours would share what they gained.
[[nodiscard]] DecodedMap Carried(const DecodedMap& map, const Image<float>& places, Cfa cfa);
// Between four valid quads in proportion, else the nearest one's.
[[nodiscard]] SeparationMap Carried(const SeparationMap& map, const Image<float>& places);
// The nearest quad's; 0 where there is none.
[[nodiscard]] Image<uint8_t> Carried(const Image<uint8_t>& mask, const Image<float>& places);

// Of profiles of `pool` x `pool` quads, `channels` each: which one lies nearest to each; -1: none.
[[nodiscard]] std::vector<int64_t> CarriedProfiles(const Image<float>& places, int pool, int channels);

}  // namespace stratalux::fit
