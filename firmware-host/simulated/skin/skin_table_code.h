// SPDX-License-Identifier: Apache-2.0
// The 16-bit code of a table entry v = S r^1.5: a straight line of log2(v), 1/256 octave (0.27 %) a step from 2^-100
// up, so that entries are interpolated in the logarithm as they stand. 0 means zero (2^-100).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

namespace stratalux::rig {

inline constexpr float kCodesPerOctave = 256.0F;
inline constexpr float kCodeFloorOctave = -100.0F;

[[nodiscard]] inline uint16_t EncodeEntry(float v) {
  if (!(v > 0.0F)) return 0;
  const float code = (std::log2(v) - kCodeFloorOctave) * kCodesPerOctave;
  return static_cast<uint16_t>(std::clamp(code + 0.5F, 1.0F, 57000.0F));
}

// `code` may lie between codes. 2^fraction by a quartic (relative error 4e-6); built so that a loop over it vectorises.
[[nodiscard]] inline float DecodeEntry(float code) {
  const float octave = code * (1.0F / kCodesPerOctave) + (kCodeFloorOctave + 127.0F);  // biased exponent: 27 .. 283
  const int32_t whole = static_cast<int32_t>(octave);
  const float f = octave - static_cast<float>(whole);
  const float mantissa = (((0.0135557F * f + 0.0520324F) * f + 0.2413793F) * f + 0.6930321F) * f + 1.0000026F;
  const int32_t bits = whole << 23;
  float power;
  std::memcpy(&power, &bits, 4);
  return mantissa * power;
}

}  // namespace stratalux::rig
