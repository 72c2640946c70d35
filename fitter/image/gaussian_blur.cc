// SPDX-License-Identifier: Apache-2.0
#include "fitter/image/gaussian_blur.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <span>
#include <vector>

#include "shared/base/parallel.h"

namespace stratalux::fit {

std::vector<float> GaussianTaps(double sigma_px) {
  const int reach = std::max(1, static_cast<int>(std::ceil(3.0 * sigma_px)));
  std::vector<float> taps(static_cast<size_t>(2 * reach + 1));
  double sum = 0.0;
  for (int k = -reach; k <= reach; ++k) {
    const double tap = std::exp(-0.5 * k * k / (sigma_px * sigma_px));
    taps[static_cast<size_t>(k + reach)] = static_cast<float>(tap);
    sum += tap;
  }
  for (float& tap : taps) tap = static_cast<float>(tap / sum);
  return taps;
}

double NoiseAboveBlur(double sigma_px) {
  const std::vector<float> taps = GaussianTaps(sigma_px);  // along each of the two axes
  const double middle = taps[taps.size() / 2];
  const double kept = std::inner_product(taps.begin(), taps.end(), taps.begin(), 0.0);
  return 1.0 - 2.0 * middle * middle + kept * kept;
}

namespace {

struct Range {
  int first = 0, end = 0;
  [[nodiscard]] int size() const { return end - first; }
  [[nodiscard]] Range Widened(int by, int limit) const { return {std::max(0, first - by), std::min(limit, end + by)}; }
};

// Where the image is not zero: a face leaves most of a picture so.
struct Filled {
  Range columns, rows;
};

Filled WhereFilled(const Image<float>& image) {
  Filled filled{{image.width(), 0}, {image.height(), 0}};
  const auto channels = static_cast<size_t>(image.channels());
  for (int y = 0; y < image.height(); ++y) {
    const std::span<const float> line(image.row(y), image.width() * channels);
    const auto zero = [](float value) { return value == 0.0F; };
    const auto first = std::ranges::find_if_not(line, zero);
    if (first == line.end()) continue;
    const auto last = std::find_if_not(line.rbegin(), line.rend(), zero);
    const auto from = static_cast<size_t>(first - line.begin()), behind = static_cast<size_t>(line.rend() - last);
    filled.columns.first = std::min(filled.columns.first, static_cast<int>(from / channels));
    filled.columns.end = std::max(filled.columns.end, static_cast<int>((behind - 1) / channels) + 1);
    filled.rows.first = std::min(filled.rows.first, y);
    filled.rows.end = y + 1;
  }
  return filled;
}

constexpr int kTogether = 16;  // values whose sums stay in registers
using Values = Eigen::Array<float, kTogether, 1>;

// `padded`: `reach` pixels of zeros before and behind the line, and room for kTogether values.
void Convolve(std::span<const float> padded, std::span<const float> taps, int channels, std::span<float> line) {
  for (size_t i = 0; i < line.size(); i += kTogether) {
    Values sum = Values::Zero();
    const float* from = padded.data() + i;
    for (const float tap : taps) {
      sum += tap * Eigen::Map<const Values>(from);
      from += channels;
    }
    const size_t count = std::min<size_t>(kTogether, line.size() - i);
    std::copy_n(sum.data(), count, line.data() + i);
  }
}

// Along x, transposed: twice it is the convolution along both.
Image<float> AlongRows(const Image<float>& in, std::span<const float> taps, const Filled& filled) {
  constexpr int kLines = 8;  // that are written side by side
  const int reach = static_cast<int>(taps.size() / 2), channels = in.channels();
  const Range reached = filled.columns.Widened(reach, in.width());
  const size_t values = static_cast<size_t>(reached.size()) * channels;
  Image<float> out(in.height(), in.width(), channels);
  ParallelFor(filled.rows.size(), kLines, [&](int64_t begin, int64_t end) {
    std::vector<float> padded(values + 2UL * reach * channels + kTogether), lines(kLines * values);
    const int first = filled.rows.first + static_cast<int>(begin), count = static_cast<int>(end - begin);
    for (int k = 0; k < count; ++k) {
      std::copy_n(&in(filled.columns.first, first + k, 0), static_cast<size_t>(filled.columns.size()) * channels,
                  padded.begin() + static_cast<ptrdiff_t>(filled.columns.first - reached.first + reach) * channels);
      Convolve(padded, taps, channels, std::span(lines).subspan(k * values, values));
    }
    for (int x = 0; x < reached.size(); ++x)
      for (int k = 0; k < count; ++k)
        for (int c = 0; c < channels; ++c)
          out(first + k, reached.first + x, c) = lines[k * values + static_cast<size_t>(x) * channels + c];
  });
  return out;
}

}  // namespace

Image<float> GaussianBlur(const Image<float>& image, double sigma_px) {
  const std::vector<float> taps = GaussianTaps(sigma_px);
  const Filled filled = WhereFilled(image);
  if (filled.rows.size() <= 0) return {image.width(), image.height(), image.channels()};
  const int reach = static_cast<int>(taps.size() / 2);
  return AlongRows(AlongRows(image, taps, filled), taps,
                   {.columns = filled.rows, .rows = filled.columns.Widened(reach, image.width())});
}

}  // namespace stratalux::fit
