// SPDX-License-Identifier: Apache-2.0
// How the samples of a stored or captured frame are laid out. The numbers are written to disk: never renumber.
#pragma once

#include <cstdint>
#include <string_view>

namespace stratalux {

enum class PixelFormat : uint16_t {
  kMono8 = 1,   // 1 byte a pixel
  kMono12 = 2,  // 16-bit little-endian containers with values 0..4095, in memory; packed as MIPI RAW12 by the codec
  kMono16 = 3,
  kF32 = 4,  // float maps of truth.seg and of fits, `channels` interleaved
};

// Colour filter array: the colours of the 2x2 block whose top left pixel is (0, 0).
enum class Cfa : uint16_t { kMono = 0, kRggb = 1, kBggr = 2, kGrbg = 3, kGbrg = 4 };

[[nodiscard]] constexpr int BytesPerSample(PixelFormat format) {
  return format == PixelFormat::kMono8 ? 1 : format == PixelFormat::kF32 ? 4 : 2;
}
[[nodiscard]] constexpr int BitDepth(PixelFormat format) {
  return format == PixelFormat::kMono8    ? 8
         : format == PixelFormat::kMono12 ? 12
         : format == PixelFormat::kMono16 ? 16
                                          : 32;
}
// The highest raw level of a format; kF32 has none.
[[nodiscard]] constexpr double FullScaleDn(PixelFormat format) { return double((uint64_t{1} << BitDepth(format)) - 1); }
// Colour (0 R, 1 G, 2 B; always 0 for mono) that the pixel (x, y) sees.
[[nodiscard]] constexpr int CfaColour(Cfa cfa, int x, int y) {
  constexpr int kColours[5][4] = {{0, 0, 0, 0}, {0, 1, 1, 2}, {2, 1, 1, 0}, {1, 0, 2, 1}, {1, 2, 0, 1}};
  return kColours[static_cast<int>(cfa)][(y & 1) * 2 + (x & 1)];
}

}  // namespace stratalux
