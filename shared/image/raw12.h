// SPDX-License-Identifier: Apache-2.0
// MIPI RAW12: two 12-bit pixels in three bytes, p0[11:4], p1[11:4], p1[3:0] << 4 | p0[3:0]; rows are byte-aligned.
#pragma once

#include <cstddef>
#include <cstdint>

namespace stratalux {

// An odd last pixel takes two bytes: p[11:4], p[3:0].
[[nodiscard]] constexpr size_t Raw12RowBytes(int width) {
  return static_cast<size_t>(width / 2) * 3 + static_cast<size_t>(width % 2) * 2;
}
// Precondition: every pixel <= 4095.
void PackRaw12Row(const uint16_t* pixels, int width, uint8_t* bytes);
void UnpackRaw12Row(const uint8_t* bytes, int width, uint16_t* pixels);

}  // namespace stratalux
