// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/camera/raw_unpack.h"

#include <algorithm>
#include <string>

#include "shared/image/raw12.h"

namespace stratalux::rig {
namespace {

void UnpackMipi10Row(const uint8_t* bytes, int width, uint16_t* samples) {
  for (int first = 0; first < width; first += 4, bytes += 5)
    for (int i = 0; i < std::min(4, width - first); ++i)
      samples[first + i] = static_cast<uint16_t>(bytes[i] << 2 | (bytes[4] >> (2 * i) & 3));
}

void UnpackRow(const RawFormat& format, const uint8_t* bytes, int width, uint16_t* samples) {
  switch (format.packing) {
    case RawPacking::kBytes:
      for (int x = 0; x < width; ++x) samples[x] = bytes[x];
      return;
    case RawPacking::kWords:
      for (int x = 0; x < width; ++x) samples[x] = static_cast<uint16_t>(bytes[2 * x] | bytes[2 * x + 1] << 8);
      return;
    case RawPacking::kWordsBig:
      for (int x = 0; x < width; ++x) samples[x] = static_cast<uint16_t>(bytes[2 * x] << 8 | bytes[2 * x + 1]);
      return;
    case RawPacking::kMipi10:
      return UnpackMipi10Row(bytes, width, samples);
    case RawPacking::kMipi12:
      return UnpackRaw12Row(bytes, width, samples);
  }
}

}  // namespace

size_t RowBytes(const RawFormat& format, int width) {
  const auto w = static_cast<size_t>(width);
  switch (format.packing) {
    case RawPacking::kBytes:
      return w;
    case RawPacking::kMipi10:
      return (w + 3) / 4 * 5;
    case RawPacking::kMipi12:
      return Raw12RowBytes(width);
    default:
      return 2 * w;
  }
}

Result<Image<uint16_t>> UnpackRaw(std::span<const uint8_t> bytes, const RawFormat& format, int width, int height,
                                  size_t stride) {
  const size_t row = RowBytes(format, width);
  const size_t needed = height == 0 ? 0 : static_cast<size_t>(height - 1) * stride + row;
  if (stride < row || bytes.size() < needed)
    return Status::Integrity("a frame of " + std::to_string(width) + "x" + std::to_string(height) + " with rows of " +
                             std::to_string(stride) + " bytes needs " + std::to_string(needed) +
                             " bytes, the buffer holds " + std::to_string(bytes.size()));
  Image<uint16_t> image(width, height);
  const auto mask = static_cast<uint16_t>((1U << format.bits) - 1);
  const int shift = format.UpShift();
  for (int y = 0; y < height; ++y) {
    UnpackRow(format, bytes.data() + static_cast<size_t>(y) * stride, width, image.row(y));
    for (int x = 0; x < width; ++x) image(x, y) = static_cast<uint16_t>((image(x, y) & mask) << shift);
  }
  return image;
}

Image<uint16_t> UnpackGreenOfBgr(std::span<const uint8_t> bytes, int width, int height, size_t stride) {
  Image<uint16_t> green(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) green(x, y) = static_cast<uint16_t>(bytes[y * stride + 3U * x + 1] << 4U);
  return green;
}

}  // namespace stratalux::rig
