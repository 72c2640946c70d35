// SPDX-License-Identifier: Apache-2.0
// Bytes of a camera's buffer -> samples. Pure functions, for every back-end.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "shared/base/result.h"
#include "shared/image/image.h"
#include "shared/image/pixel_format.h"

namespace stratalux::rig {

enum class RawPacking : uint8_t {
  kBytes,     // 8 bits: a byte a sample
  kWords,     // 10 to 16 bits: a little-endian word a sample, value in the low bits
  kWordsBig,  // 16 bits, big-endian
  kMipi10,    // four samples in five bytes: their high bytes, then their low bits, the first sample lowest
  kMipi12,    // two samples in three bytes (shared/image/raw12.h)
};

struct RawFormat {
  int bits = 8;
  RawPacking packing = RawPacking::kBytes;
  Cfa cfa = Cfa::kMono;

  // Up to 12 bits: kMono12, values moved to its upper bits (a 10-bit 1023 is 4092), as the simulated sensor does.
  [[nodiscard]] PixelFormat pixel_format() const { return bits <= 12 ? PixelFormat::kMono12 : PixelFormat::kMono16; }
  // By which UnpackRaw moves values up, and the highest sample that it makes so.
  [[nodiscard]] int UpShift() const { return bits < 12 ? 12 - bits : 0; }
  [[nodiscard]] double FullScaleDn() const { return ((1 << bits) - 1) << UpShift(); }
};

// Bytes of a row without padding.
[[nodiscard]] size_t RowBytes(const RawFormat& format, int width);

// Rows begin every `stride` bytes. kIntegrity where `bytes` ends before the last row does. Bits above the format's are
// cut off.
[[nodiscard]] Result<Image<uint16_t>> UnpackRaw(std::span<const uint8_t> bytes, const RawFormat& format, int width,
                                                int height, size_t stride);

// The green of BGR888, 8 bits moved to the upper ones of 12; `bytes` hold `height` rows of `stride` bytes.
[[nodiscard]] Image<uint16_t> UnpackGreenOfBgr(std::span<const uint8_t> bytes, int width, int height, size_t stride);

}  // namespace stratalux::rig
