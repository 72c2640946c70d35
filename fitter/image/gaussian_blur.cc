// SPDX-License-Identifier: Apache-2.0
#include "fitter/image/gaussian_blur.h"

#include <algorithm>
#include <cmath>
#include <numeric>
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

// Along x, transposed: twice it is the convolution along both.
Image<float> AlongRows(const Image<float>& in, const std::vector<float>& taps) {
  const int reach = static_cast<int>(taps.size() / 2), width = in.width(), channels = in.channels();
  Image<float> out(in.height(), width, channels);
  ParallelFor(in.height(), 8, [&](int64_t begin, int64_t end) {
    std::vector<float> row(static_cast<size_t>(width) * channels);
    for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) {
      std::ranges::fill(row, 0.0F);
      // Tap by tap: neighbours side by side are what a compiler turns into wide instructions.
      for (int k = -std::min(reach, width - 1); k <= std::min(reach, width - 1); ++k) {
        const int first = std::max(0, -k), count = (std::min(width, width - k) - first) * channels;
        const float tap = taps[static_cast<size_t>(k + reach)];
        const float* from = &in(first + k, y, 0);
        float* to = row.data() + static_cast<size_t>(first) * channels;
        for (int i = 0; i < count; ++i) to[i] += tap * from[i];
      }
      for (int x = 0; x < width; ++x)
        for (int c = 0; c < channels; ++c) out(y, x, c) = row[static_cast<size_t>(x) * channels + c];
    }
  });
  return out;
}

}  // namespace

Image<float> GaussianBlur(const Image<float>& image, double sigma_px) {
  const std::vector<float> taps = GaussianTaps(sigma_px);
  return AlongRows(AlongRows(image, taps), taps);
}

}  // namespace stratalux::fit
