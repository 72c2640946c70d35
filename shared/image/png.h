// SPDX-License-Identifier: Apache-2.0
// PNG files through libpng: the only image-file code the controller links.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux {

// Gray (1 channel) or colour (3 channels), 8 or 16 bit; palettes are expanded, alpha is dropped. `bit_depth` (may be
// null) receives 8 or 16. kNotFound: no such file; kUsage: not a PNG file; kIntegrity: damaged, truncated or of more
// than kMostImagePixels.
[[nodiscard]] Result<Image<uint16_t>> ReadPng(const std::filesystem::path& file, int* bit_depth);

// 1 or 3 channels; of 8 bits 2 or 4, too: the last is alpha, straight.
Status WritePng8(const std::filesystem::path& file, ImageView<const uint8_t> image);
Status WritePng16(const std::filesystem::path& file, ImageView<const uint16_t> image);
// kFast: a third of the time; pictures of a report are 4 % larger, smooth ones more (no filters).
enum class PngEffort : uint8_t { kSmall, kFast };
// The bytes of a PNG file, for data URIs.
[[nodiscard]] Result<std::vector<uint8_t>> EncodePng8(ImageView<const uint8_t> image,
                                                      PngEffort effort = PngEffort::kSmall);

}  // namespace stratalux
