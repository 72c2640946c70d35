// SPDX-License-Identifier: Apache-2.0
// The planes are what the header's formula says, by a twin written pixel by pixel from it.
#include "db/segment/delta_planes.h"

#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace stratalux::db {
namespace {

// Pixel (x, y), channel c; the formula of delta_planes.h and nothing else.
class Twin {
 public:
  Twin(const FrameShape& shape, const std::vector<uint16_t>& samples) : shape_(shape), samples_(samples) {}

  [[nodiscard]] unsigned Z(int x, int y, int c) const {
    const int d = shape_.cfa == Cfa::kMono ? 1 : 2;
    unsigned predicted = 0;
    if (x >= d && y >= d) {
      predicted = (S(x - d, y, c) + S(x, y - d, c) + 1) / 2;
    } else if (x >= d) {
      predicted = S(x - d, y, c);
    } else if (y >= d) {
      predicted = S(x, y - d, c);
    }
    const int residual = static_cast<int16_t>(static_cast<uint16_t>(S(x, y, c) - predicted));
    return residual >= 0 ? 2U * static_cast<unsigned>(residual) : 2U * static_cast<unsigned>(-residual) - 1U;
  }

 private:
  [[nodiscard]] unsigned S(int x, int y, int c) const {
    return samples_[(static_cast<size_t>(y) * shape_.width + x) * shape_.channels + c];
  }
  const FrameShape& shape_;
  const std::vector<uint16_t>& samples_;
};

std::vector<uint16_t> Noise(const FrameShape& shape) {
  std::mt19937 random(static_cast<unsigned>(shape.width * 31 + shape.height));
  std::vector<uint16_t> samples(shape.samples());
  for (uint16_t& v : samples) v = static_cast<uint16_t>(random());
  return samples;
}

const FrameShape kShapes[] = {
    {PixelFormat::kMono16, Cfa::kRggb, 17, 9, 1}, {PixelFormat::kMono16, Cfa::kMono, 17, 9, 1},
    {PixelFormat::kMono16, Cfa::kGbrg, 1, 9, 1},  {PixelFormat::kMono16, Cfa::kMono, 1, 1, 1},
    {PixelFormat::kMono16, Cfa::kBggr, 40, 1, 1}, {PixelFormat::kMono16, Cfa::kMono, 5, 4, 3},
    {PixelFormat::kMono16, Cfa::kGrbg, 6, 5, 2},  {PixelFormat::kMono16, Cfa::kMono, 2, 7, 1}};

TEST(DeltaPlanes, AreTheFormulaOfTheHeader) {
  for (const FrameShape& shape : kShapes) {
    const auto samples = Noise(shape);
    const Twin twin(shape, samples);
    std::vector<uint8_t> planes(2 * samples.size());
    SplitPlanes(shape, std::span<const uint16_t>(samples), planes);
    size_t i = 0;
    for (int y = 0; y < shape.height; ++y)
      for (int x = 0; x < shape.width; ++x)
        for (int c = 0; c < shape.channels; ++c, ++i)
          ASSERT_EQ(planes[i] | planes[samples.size() + i] << 8, twin.Z(x, y, c))
              << shape.width << " x " << shape.height << " at " << x << ", " << y;
  }
}

TEST(DeltaPlanes, JoinUndoesSplitForEverySample) {
  for (const FrameShape& shape : kShapes) {
    const auto samples = Noise(shape);
    std::vector<uint8_t> planes(2 * samples.size());
    SplitPlanes(shape, std::span<const uint16_t>(samples), planes);
    std::vector<uint16_t> joined(samples.size(), 0xabcd);
    uint16_t bits = 0;
    for (const uint16_t v : samples) bits |= v;
    EXPECT_EQ(JoinPlanes(shape, planes, joined), bits);
    EXPECT_EQ(joined, samples) << shape.width << " x " << shape.height;
  }
}

TEST(DeltaPlanes, EightBitSamplesGiveThePlanesOfTheirWidenedTwins) {
  const FrameShape shape{PixelFormat::kMono8, Cfa::kRggb, 33, 12, 1};
  std::vector<uint8_t> narrow(shape.samples());
  std::vector<uint16_t> wide(shape.samples());
  for (size_t i = 0; i < narrow.size(); ++i) wide[i] = narrow[i] = static_cast<uint8_t>(i * 37 + i / 33);
  std::vector<uint8_t> a(2 * narrow.size()), b(2 * narrow.size());
  SplitPlanes(shape, std::span<const uint8_t>(narrow), a);
  SplitPlanes(shape, std::span<const uint16_t>(wide), b);
  EXPECT_EQ(a, b);
}

// Two equal halves of the colours' levels: a predictor that crossed colours would leave large residuals.
TEST(DeltaPlanes, ColoursDoNotPredictEachOther) {
  const FrameShape shape{PixelFormat::kMono12, Cfa::kGrbg, 16, 8, 1};
  std::vector<uint16_t> samples(shape.samples());
  for (int y = 0; y < shape.height; ++y)
    for (int x = 0; x < shape.width; ++x) samples[y * 16 + x] = static_cast<uint16_t>(1000 * ((y % 2) * 2 + x % 2));
  std::vector<uint8_t> planes(2 * samples.size());
  SplitPlanes(shape, std::span<const uint16_t>(samples), planes);
  for (size_t i = 0; i < samples.size(); ++i) {
    const bool corner = i / 16 < 2 && i % 16 < 2;
    EXPECT_EQ(planes[i] | planes[samples.size() + i] << 8, corner ? 2 * samples[i] : 0) << i;
  }
}

}  // namespace
}  // namespace stratalux::db
