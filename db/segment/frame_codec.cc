// SPDX-License-Identifier: Apache-2.0
#include "db/segment/frame_codec.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <string>

#include <zstd.h>

#include "db/segment/delta_planes.h"
#include "shared/image/raw12.h"

namespace stratalux::db {
namespace {

static_assert(std::endian::native == std::endian::little, "16-bit samples are stored as they lie in memory");

// Level 1: noise has no repetitions for higher levels to find; they cost time and gain nothing (docs/benchmarks.md).
constexpr int kZstdLevel = 1;
constexpr int kLargestSide = 65536, kMostChannels = 64;
constexpr size_t kMostSamples = size_t{1} << 28;  // 256 M: no camera's frame, but damage may ask for any number

unsigned TopOf(PixelFormat format) { return (1U << std::min(BitDepth(format), 16)) - 1U; }

// The or of all samples, then the sample itself: the usual frame is read once, in vector steps.
Status CheckDepth(const FrameShape& shape, std::span<const uint16_t> samples) {
  const unsigned top = TopOf(shape.format);
  unsigned bits = 0;
  for (const uint16_t v : samples) bits |= v;
  if (bits <= top) return Status::Ok();
  const auto over = std::find_if(samples.begin(), samples.end(), [top](uint16_t v) { return v > top; });
  return Status::Usage("value " + std::to_string(*over) + " exceeds " + std::to_string(BitDepth(shape.format)) +
                       " bits");
}

void Raw(const FrameShape& shape, std::span<const uint16_t> samples, std::vector<uint8_t>& out) {
  const Codec codec = RawCodec(shape);
  out.resize(RawBytes(shape, codec));
  const size_t row_bytes = out.size() / static_cast<size_t>(shape.height);
  switch (codec) {
    case Codec::kRaw12:
      for (int y = 0; y < shape.height; ++y)
        PackRaw12Row(samples.data() + shape.row_samples() * y, shape.width, out.data() + row_bytes * y);
      return;
    case Codec::kRaw8:
      std::transform(samples.begin(), samples.end(), out.begin(), [](uint16_t v) { return static_cast<uint8_t>(v); });
      return;
    default:
      std::memcpy(out.data(), samples.data(), out.size());
  }
}
void Raw(const FrameShape&, std::span<const uint8_t> samples, std::vector<uint8_t>& out) {
  out.assign(samples.begin(), samples.end());
}

}  // namespace

Status CheckShape(const FrameShape& s) {
  const bool sane = s.width > 0 && s.height > 0 && s.channels > 0 && s.width <= kLargestSide &&
                    s.height <= kLargestSide && s.channels <= kMostChannels && s.samples() <= kMostSamples;
  if (sane) return Status::Ok();
  return Status::Integrity("impossible size " + std::to_string(s.width) + " x " + std::to_string(s.height) + " x " +
                           std::to_string(s.channels));
}

struct FrameEncoder::Impl {
  struct Closer {
    void operator()(ZSTD_CCtx* context) const { ZSTD_freeCCtx(context); }
  };
  StoreCodec codec;
  std::unique_ptr<ZSTD_CCtx, Closer> zstd;
  std::vector<uint8_t> planes, compressed, raw;

  template <typename T>
  Result<EncodedFrame> Encode(const FrameShape& shape, std::span<const T> samples) {
    SLX_RETURN_IF_ERROR(CheckShape(shape));
    if (samples.size() != shape.samples() || shape.format == PixelFormat::kF32)
      return Status::Usage("samples do not fit the frame's format and size");
    if (codec == StoreCodec::kDelta) {
      SLX_ASSIGN_OR_RETURN(const size_t bytes, Compress(shape, samples));
      if (bytes < RawBytes(shape, RawCodec(shape)))
        return EncodedFrame{Codec::kDelta, std::span<const uint8_t>(compressed).first(bytes)};
    }
    Raw(shape, samples, raw);
    return EncodedFrame{RawCodec(shape), raw};
  }
  template <typename T>
  Result<size_t> Compress(const FrameShape& shape, std::span<const T> samples) {
    planes.resize(2 * shape.samples());
    SplitPlanes(shape, samples, planes);
    compressed.resize(ZSTD_compressBound(planes.size()));
    const size_t bytes = ZSTD_compress2(zstd.get(), compressed.data(), compressed.size(), planes.data(), planes.size());
    if (ZSTD_isError(bytes)) return Status::Failed(std::string("zstd: ") + ZSTD_getErrorName(bytes));
    return bytes;
  }
};

FrameEncoder::FrameEncoder(StoreCodec codec) : impl_(new Impl{codec, nullptr, {}, {}, {}}) {
  if (codec != StoreCodec::kDelta) return;
  impl_->zstd.reset(ZSTD_createCCtx());
  SLX_CHECK(impl_->zstd != nullptr);
  ZSTD_CCtx_setParameter(impl_->zstd.get(), ZSTD_c_compressionLevel, kZstdLevel);
  // The payload's own hash guards it on the disk; this one finds damage where no header is at hand.
  ZSTD_CCtx_setParameter(impl_->zstd.get(), ZSTD_c_checksumFlag, 1);
}
FrameEncoder::~FrameEncoder() = default;
FrameEncoder::FrameEncoder(FrameEncoder&&) noexcept = default;
FrameEncoder& FrameEncoder::operator=(FrameEncoder&&) noexcept = default;

Result<EncodedFrame> FrameEncoder::Encode(const FrameShape& shape, std::span<const uint16_t> samples) {
  SLX_RETURN_IF_ERROR(CheckDepth(shape, samples));
  return impl_->Encode(shape, samples);
}
Result<EncodedFrame> FrameEncoder::Encode(const FrameShape& shape, std::span<const uint8_t> samples) {
  if (shape.format != PixelFormat::kMono8) return Status::Usage("8-bit samples of a frame of another format");
  return impl_->Encode(shape, samples);
}

struct FrameDecoder::Impl {
  struct Closer {
    void operator()(ZSTD_DCtx* context) const { ZSTD_freeDCtx(context); }
  };
  std::unique_ptr<ZSTD_DCtx, Closer> zstd;
  std::vector<uint8_t> planes;

  Status Delta(const FrameShape& shape, std::span<const uint8_t> payload, Image<uint16_t>& image) {
    // Asked before anything is allocated: damage may name any size, but the payload knows its own.
    const size_t bytes = 2 * shape.samples();
    if (ZSTD_getFrameContentSize(payload.data(), payload.size()) != bytes)
      return Status::Integrity("compressed planes do not have the frame's size");
    planes.resize(bytes);
    const size_t done = ZSTD_decompressDCtx(zstd.get(), planes.data(), bytes, payload.data(), payload.size());
    if (ZSTD_isError(done))
      return Status::Integrity(std::string("compressed planes are damaged: ") + ZSTD_getErrorName(done));
    if (done != bytes) return Status::Integrity("compressed planes end early");
    image = Image<uint16_t>(shape.width, shape.height, shape.channels);
    if (JoinPlanes(shape, planes, image.pixels()) > TopOf(shape.format))
      return Status::Integrity("decoded values exceed " + std::to_string(BitDepth(shape.format)) + " bits");
    return Status::Ok();
  }
};

FrameDecoder::FrameDecoder() : impl_(new Impl) {
  impl_->zstd.reset(ZSTD_createDCtx());
  SLX_CHECK(impl_->zstd != nullptr);
}
FrameDecoder::~FrameDecoder() = default;
FrameDecoder::FrameDecoder(FrameDecoder&&) noexcept = default;
FrameDecoder& FrameDecoder::operator=(FrameDecoder&&) noexcept = default;

Result<Image<uint16_t>> FrameDecoder::Decode(const FrameShape& shape, Codec codec, std::span<const uint8_t> payload) {
  SLX_RETURN_IF_ERROR(CheckShape(shape));
  Image<uint16_t> image;
  if (codec == Codec::kDelta) {
    SLX_RETURN_IF_ERROR(impl_->Delta(shape, payload, image));
    return image;
  }
  if (static_cast<uint16_t>(codec) > static_cast<uint16_t>(Codec::kDelta))
    return Status(StatusCode::kNewerSchema, "codec " + std::to_string(static_cast<int>(codec)) +
                                                " is newer than this program; use a newer stratalux");
  if (codec == Codec::kF32 || payload.size() != RawBytes(shape, codec) ||
      (codec == Codec::kRaw12 && shape.channels != 1))
    return Status::Integrity("payload length does not fit size and codec");
  image = Image<uint16_t>(shape.width, shape.height, shape.channels);
  if (codec == Codec::kRaw8) std::copy(payload.begin(), payload.end(), image.data());
  if (codec == Codec::kRaw16) std::memcpy(image.data(), payload.data(), payload.size());
  if (codec == Codec::kRaw12)
    for (int y = 0; y < shape.height; ++y)
      UnpackRaw12Row(payload.data() + Raw12RowBytes(shape.width) * y, shape.width, image.row(y));
  return image;
}

}  // namespace stratalux::db
