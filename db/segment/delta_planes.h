// SPDX-License-Identifier: Apache-2.0
// The `delta` codec without its entropy stage: samples <-> two planes of bytes.
//
//   P(x, y) = (S(x - d, y) + S(x, y - d) + 1) >> 1     d: colour_pitch of the shape, in pixels; S: samples, mod 2^16
//             S(x - d, y) where y < d,  S(x, y - d) where x < d,  0 where both
//   R(x, y) = (S - P) mod 2^16, read as a signed number
//   Z(x, y) = R >= 0 ? 2 R : -2 R - 1                  16 bits
//   planes  = low byte of every Z, then high byte of every Z; rows top to bottom, channels interleaved
//
// Frozen: docs/file-formats.md. The mean of two neighbours of the same colour carries 1/4 less noise power into R than
// one of them does (1.5 against 2 times the pixel's), 0.2 bit a pixel. The rounding is that of x86's pavgw and arm64's
// urhadd.
#pragma once

#include <cstdint>
#include <span>

#include "db/segment/codec.h"

namespace stratalux::db {

// `planes`: 2 x shape.samples() bytes. Reentrant.
void SplitPlanes(const FrameShape& shape, std::span<const uint16_t> samples, std::span<uint8_t> planes);
void SplitPlanes(const FrameShape& shape, std::span<const uint8_t> samples, std::span<uint8_t> planes);

// The inverse, for any bytes. Returns the bitwise or of all samples: a bit above the format's depth betrays a wrong
// plane.
uint16_t JoinPlanes(const FrameShape& shape, std::span<const uint8_t> planes, std::span<uint16_t> samples);

}  // namespace stratalux::db
