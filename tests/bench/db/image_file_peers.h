// SPDX-License-Identifier: Apache-2.0
// The image files that the codec is measured against, written to memory. 16-bit gray samples.
#pragma once

#include <cstdint>
#include <vector>

#include "shared/image/image.h"

namespace stratalux::bench {

enum class TiffCompression { kDeflate, kZstd };

// Level 1, filter `sub`: the fastest setting that still predicts. Bytes of the file.
size_t EncodePng(ImageView<const uint16_t> pixels, std::vector<uint8_t>& file);
// Level 1, horizontal predictor, strips of 64 rows.
size_t EncodeTiff(ImageView<const uint16_t> pixels, TiffCompression compression, std::vector<uint8_t>& file);

}  // namespace stratalux::bench
