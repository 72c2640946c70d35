// SPDX-License-Identifier: Apache-2.0
#include "db/segment/delta_planes.h"

#include <algorithm>

namespace stratalux::db {
namespace {

constexpr uint16_t ZigZag(uint16_t r) { return static_cast<uint16_t>((r << 1) ^ (r & 0x8000U ? 0xffffU : 0U)); }
constexpr uint16_t UnZigZag(uint16_t z) { return static_cast<uint16_t>((z >> 1) ^ (z & 1U ? 0xffffU : 0U)); }
static_assert(ZigZag(0xffff) == 1 && ZigZag(1) == 2 && UnZigZag(ZigZag(0x8000)) == 0x8000);

void Put(uint16_t sample, uint16_t predicted, uint8_t& low, uint8_t& high) {
  const uint16_t z = ZigZag(static_cast<uint16_t>(sample - predicted));
  low = static_cast<uint8_t>(z);
  high = static_cast<uint8_t>(z >> 8);
}

// One row of `count` samples; `above` is the row `colour_pitch` higher, `left` the distance to the left neighbour.
// __restrict: bytes may alias anything, which would keep the loop from being vectorised.
template <typename T>
void SplitRow(const T* __restrict row, const T* __restrict above, size_t count, size_t left, uint8_t* __restrict low,
              uint8_t* __restrict high) {
  const size_t margin = std::min(left, count);
  for (size_t x = 0; x < margin; ++x) Put(row[x], above[x], low[x], high[x]);
  for (size_t x = margin; x < count; ++x) {
    const auto mean = static_cast<uint16_t>((row[x - left] + above[x] + 1) >> 1);
    Put(row[x], mean, low[x], high[x]);
  }
}

template <typename T>
void SplitTopRow(const T* row, size_t count, size_t left, uint8_t* low, uint8_t* high) {
  for (size_t x = 0; x < count; ++x) Put(row[x], x < left ? T{0} : row[x - left], low[x], high[x]);
}

template <typename T>
void Split(const FrameShape& shape, const T* samples, uint8_t* planes) {
  const size_t count = shape.row_samples();
  const size_t pitch = shape.colour_pitch(), left = pitch * shape.channels;
  uint8_t* low = planes;
  uint8_t* high = planes + shape.samples();
  for (size_t y = 0; y < static_cast<size_t>(shape.height); ++y) {
    const T* row = samples + y * count;
    if (y < pitch) {
      SplitTopRow(row, count, left, low + y * count, high + y * count);
    } else {
      SplitRow(row, row - pitch * count, count, left, low + y * count, high + y * count);
    }
  }
}

void UnZigZagRow(const uint8_t* __restrict low, const uint8_t* __restrict high, size_t count,
                 uint16_t* __restrict residuals) {
  for (size_t x = 0; x < count; ++x) residuals[x] = UnZigZag(static_cast<uint16_t>(low[x] | high[x] << 8));
}

// `row`: residuals in, samples out. Each sample waits for its left neighbour; the kLeft chains of a row run side by
// side in registers.
template <int kLeft>
void JoinRow(uint16_t* __restrict row, const uint16_t* __restrict above, size_t count) {
  if (count < kLeft) {
    for (size_t x = 0; x < count; ++x) row[x] = static_cast<uint16_t>(row[x] + above[x]);
    return;
  }
  uint32_t last[kLeft];
  for (int k = 0; k < kLeft; ++k) last[k] = row[k] = static_cast<uint16_t>(row[k] + above[k]);
  size_t x = kLeft;
  for (; x + kLeft <= count; x += kLeft)
    for (int k = 0; k < kLeft; ++k) {
      last[k] = (row[x + k] + ((last[k] + above[x + k] + 1U) >> 1)) & 0xffffU;
      row[x + k] = static_cast<uint16_t>(last[k]);
    }
  for (int k = 0; x < count; ++x, ++k) row[x] = static_cast<uint16_t>(row[x] + ((last[k] + above[x] + 1U) >> 1));
}

void JoinRow(uint16_t* row, const uint16_t* above, size_t count, size_t left) {
  for (size_t x = 0; x < count; ++x) {
    const unsigned predicted = x < left ? above[x] : (row[x - left] + above[x] + 1U) >> 1;
    row[x] = static_cast<uint16_t>(row[x] + predicted);
  }
}

void JoinTopRow(uint16_t* row, size_t count, size_t left) {
  for (size_t x = left; x < count; ++x) row[x] = static_cast<uint16_t>(row[x] + row[x - left]);
}

uint16_t BitsOf(std::span<const uint16_t> samples) {
  uint16_t bits = 0;
  for (const uint16_t v : samples) bits |= v;
  return bits;
}

}  // namespace

void SplitPlanes(const FrameShape& shape, std::span<const uint16_t> samples, std::span<uint8_t> planes) {
  Split(shape, samples.data(), planes.data());
}
void SplitPlanes(const FrameShape& shape, std::span<const uint8_t> samples, std::span<uint8_t> planes) {
  Split(shape, samples.data(), planes.data());
}

uint16_t JoinPlanes(const FrameShape& shape, std::span<const uint8_t> planes, std::span<uint16_t> samples) {
  const size_t count = shape.row_samples();
  const size_t pitch = shape.colour_pitch(), left = pitch * shape.channels;
  const uint8_t* low = planes.data();
  const uint8_t* high = planes.data() + shape.samples();
  uint16_t bits = 0;
  for (size_t y = 0; y < static_cast<size_t>(shape.height); ++y) {
    uint16_t* row = samples.data() + y * count;
    UnZigZagRow(low + y * count, high + y * count, count, row);
    if (y < pitch) {
      JoinTopRow(row, count, left);
    } else if (left == 1) {
      JoinRow<1>(row, row - pitch * count, count);
    } else if (left == 2) {
      JoinRow<2>(row, row - pitch * count, count);
    } else {
      JoinRow(row, row - pitch * count, count, left);
    }
    bits |= BitsOf({row, count});
  }
  return bits;
}

}  // namespace stratalux::db
