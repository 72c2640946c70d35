// SPDX-License-Identifier: Apache-2.0
#include "db/segment/codec.h"

#include "shared/image/raw12.h"

namespace stratalux::db {

const char* ToString(Codec codec) {
  switch (codec) {
    case Codec::kRaw8:
      return "raw8";
    case Codec::kRaw12:
      return "raw12";
    case Codec::kRaw16:
      return "raw16";
    case Codec::kF32:
      return "f32";
    case Codec::kDelta:
      return "delta";
  }
  return "unknown";
}

Codec RawCodec(const FrameShape& shape) {
  switch (shape.format) {
    case PixelFormat::kMono8:
      return Codec::kRaw8;
    case PixelFormat::kMono12:
      return shape.channels == 1 ? Codec::kRaw12 : Codec::kRaw16;
    case PixelFormat::kF32:
      return Codec::kF32;
    case PixelFormat::kMono16:
      break;
  }
  return Codec::kRaw16;
}

size_t RawBytes(const FrameShape& shape, Codec codec) {
  switch (codec) {
    case Codec::kRaw8:
      return shape.samples();
    case Codec::kRaw12:
      return Raw12RowBytes(shape.width) * shape.height;
    case Codec::kRaw16:
      return shape.samples() * 2;
    case Codec::kF32:
      return shape.samples() * 4;
    case Codec::kDelta:
      break;
  }
  return 0;
}

}  // namespace stratalux::db
