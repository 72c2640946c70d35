// SPDX-License-Identifier: Apache-2.0
#include "fitter/motion/skin_detail.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "fitter/image/gaussian_blur.h"
#include "shared/base/median.h"

namespace stratalux::fit {
namespace {

// Mean over colours; NaN where one is not known.
Image<float> Brightness(const Image<float>& light) {
  Image<float> mean(light.width(), light.height());
  const int channels = light.channels();
  for (size_t i = 0; i < mean.size(); ++i) {
    float sum = 0.0F;
    for (int c = 0; c < channels; ++c)
      sum += light.pixels()[i * static_cast<size_t>(channels) + static_cast<size_t>(c)];
    mean.pixels()[i] = sum / static_cast<float>(channels);
  }
  return mean;
}

}  // namespace

Image<float> BlurredOver(const Image<float>& values, double sigma_quads, Image<float>* share) {
  const int channels = values.channels();
  Image<float> with_weight(values.width(), values.height(), channels + 1);
  for (size_t i = 0; i < with_weight.size(); i += static_cast<size_t>(channels) + 1) {
    const float* from = values.data() + i / (static_cast<size_t>(channels) + 1) * static_cast<size_t>(channels);
    if (!std::isfinite(from[0])) continue;
    std::copy_n(from, channels, with_weight.data() + i);
    with_weight.data()[i + static_cast<size_t>(channels)] = 1.0F;
  }
  with_weight = GaussianBlur(with_weight, sigma_quads);
  Image<float> blurred(values.width(), values.height(), channels, std::nanf(""));
  if (share != nullptr) *share = Image<float>(values.width(), values.height());
  for (int y = 0; y < values.height(); ++y)
    for (int x = 0; x < values.width(); ++x) {
      const float weight = with_weight(x, y, channels);
      if (share != nullptr) (*share)(x, y) = weight;
      for (int c = 0; c < channels && weight > 1e-6F; ++c) blurred(x, y, c) = with_weight(x, y, c) / weight;
    }
  return blurred;
}

Image<float> Binned(const Image<float>& image, int n) {
  Image<float> binned(image.width() / n, image.height() / n, image.channels());
  for (int y = 0; y < binned.height(); ++y)
    for (int x = 0; x < binned.width(); ++x)
      for (int c = 0; c < image.channels(); ++c) {
        float sum = 0.0F;
        int known = 0;
        for (int b = 0; b < n; ++b)
          for (int a = 0; a < n; ++a)
            if (const float v = image(n * x + a, n * y + b, c); std::isfinite(v)) {
              sum += v;
              ++known;
            }
        binned(x, y, c) = 2 * known >= n * n ? sum / static_cast<float>(known) : std::nanf("");
      }
  return binned;
}

Image<float> LogLight(const Image<float>& light, const Image<uint8_t>& lit, double sigma_quads) {
  constexpr double kLeastShare = 0.05;   // of the picture's median light: what is darker is shadow
  constexpr float kLeastWeight = 0.75F;  // of the Gaussian on quads that have light
  Image<float> log_light = Brightness(light);
  std::vector<double> levels;
  for (size_t i = 0; i < log_light.size(); ++i)
    if (lit.pixels()[i] != 0 && std::isfinite(log_light.pixels()[i])) levels.push_back(log_light.pixels()[i]);
  const auto least = static_cast<float>(kLeastShare * std::max(0.0, Median(std::move(levels))));
  for (size_t i = 0; i < log_light.size(); ++i) {
    float& v = log_light.pixels()[i];
    v = lit.pixels()[i] != 0 && v > least && v > 0.0F ? std::log(v) : std::nanf("");
  }
  Image<float> share;
  Image<float> blurred = BlurredOver(log_light, sigma_quads, &share);
  for (size_t i = 0; i < blurred.size(); ++i)
    if (!std::isfinite(log_light.pixels()[i]) || share.pixels()[i] < kLeastWeight) blurred.pixels()[i] = std::nanf("");
  return blurred;
}

}  // namespace stratalux::fit
