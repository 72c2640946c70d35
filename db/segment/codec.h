// SPDX-License-Identifier: Apache-2.0
// The codecs of a stored frame. The numbers are written to disk: never renumber.
#pragma once

#include <cstddef>
#include <cstdint>

#include "shared/image/pixel_format.h"

namespace stratalux::db {

enum class Codec : uint16_t { kRaw8 = 1, kRaw12 = 2, kRaw16 = 3, kF32 = 4, kDelta = 5 };
[[nodiscard]] const char* ToString(Codec codec);  // "raw8", ..., "unknown"

// What must be known of a frame to code it; all of it stands in the frame header.
struct FrameShape {
  PixelFormat format = PixelFormat::kMono12;
  Cfa cfa = Cfa::kMono;
  int width = 0;
  int height = 0;
  int channels = 1;  // interleaved

  [[nodiscard]] size_t samples() const { return static_cast<size_t>(width) * height * channels; }
  [[nodiscard]] size_t row_samples() const { return static_cast<size_t>(width) * channels; }
  // Distance in pixels, along a row and along a column, to the next pixel of the same colour.
  [[nodiscard]] int colour_pitch() const { return cfa == Cfa::kMono ? 1 : 2; }
};

// The codec that stores the samples as they are: raw8, raw12 (one channel of 12 bits), raw16 or f32.
[[nodiscard]] Codec RawCodec(const FrameShape& shape);
// Bytes of a payload of one of the raw codecs; 0 for the others.
[[nodiscard]] size_t RawBytes(const FrameShape& shape, Codec codec);

}  // namespace stratalux::db
