// SPDX-License-Identifier: Apache-2.0
// Image files that other rigs leave: PNG, TIFF, TGA, PGM and PPM.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::db {

inline constexpr int kLargestSide = 65536;  // of an image that is read, pixels

struct ImageFile {
  Image<uint16_t> image;  // 1 channel (grey) or 3 (R, G, B); alpha is dropped
  int bits = 8;           // of a sample of the file: 8 or 16
};

// By the first bytes; TGA, which has none of its own, by the name's end. kNotFound: no such file. kUsage: none of these
// formats, or a kind of it that is not read (the message says which kinds are). kIntegrity naming file and offset:
// damaged or truncated.
[[nodiscard]] Result<ImageFile> ReadImageFile(const std::filesystem::path& file);

// The decoders behind it; `file` is for messages. Sides up to kLargestSide, at most kMostImagePixels
// (shared/image/png.h), and never more pixels than the bytes can hold: a header that lies is given no memory. kUsage
// naming file, size and limit where there are more pixels than are read.
[[nodiscard]] Status CheckPixelCount(uint64_t width, uint64_t height, const std::string& file);
[[nodiscard]] Result<ImageFile> DecodeTga(std::span<const uint8_t> bytes, const std::string& file);
[[nodiscard]] Result<ImageFile> DecodePnm(std::span<const uint8_t> bytes, const std::string& file);
[[nodiscard]] Result<ImageFile> DecodeTiff(std::span<const uint8_t> bytes, const std::string& file);

// 1 or 3 channels, strips with deflate. `description`: the tag ImageDescription, ASCII; empty: none.
Status WriteTiff8(const std::filesystem::path& file, ImageView<const uint8_t> image);
Status WriteTiff16(const std::filesystem::path& file, ImageView<const uint16_t> image,
                   const std::string& description = {});

}  // namespace stratalux::db
