// SPDX-License-Identifier: Apache-2.0
// Samples of a frame <-> payload of a segment record (docs/file-formats.md). Lossless.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "db/segment/codec.h"
#include "shared/base/result.h"
#include "shared/capture/store_codec.h"
#include "shared/image/image.h"

namespace stratalux::db {

struct EncodedFrame {
  Codec codec = Codec::kRaw16;
  std::span<const uint8_t> bytes;  // the encoder's, until its next call
};

// kIntegrity for sizes that no camera's frame has, but damage may name.
[[nodiscard]] Status CheckShape(const FrameShape& shape);

// Thread-bound. Buffers grow to the largest frame and stay: no allocation per frame after the first.
class FrameEncoder {
 public:
  explicit FrameEncoder(StoreCodec codec);
  ~FrameEncoder();
  FrameEncoder(FrameEncoder&&) noexcept;
  FrameEncoder& operator=(FrameEncoder&&) noexcept;

  // What `delta` does not shrink (such as noise over all bits, or a few pixels) is stored raw: `codec` says which it
  // was. kUsage: a sample above the format's bit depth, samples that are not shape.samples(), or 8-bit samples of
  // another format than kMono8.
  Result<EncodedFrame> Encode(const FrameShape& shape, std::span<const uint16_t> samples);
  Result<EncodedFrame> Encode(const FrameShape& shape, std::span<const uint8_t> samples);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Thread-bound. Whatever the bytes, Decode() returns an image of `shape` or kIntegrity.
class FrameDecoder {
 public:
  FrameDecoder();
  ~FrameDecoder();
  FrameDecoder(FrameDecoder&&) noexcept;
  FrameDecoder& operator=(FrameDecoder&&) noexcept;

  // 8-bit samples are widened. kNewerSchema for a codec this program does not know; f32 is not for frames (kIntegrity).
  Result<Image<uint16_t>> Decode(const FrameShape& shape, Codec codec, std::span<const uint8_t> payload);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace stratalux::db
