// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/pictures.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>

#include "shared/base/formatted.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

// Seven anchors of a dark-to-light scale with even steps of lightness.
constexpr std::array<std::array<double, 3>, 7> kScale = {
    {{13, 8, 65}, {75, 3, 161}, {139, 10, 165}, {185, 50, 137}, {219, 92, 104}, {244, 136, 73}, {240, 249, 33}}};

uint8_t SrgbByte(double linear) {
  const double v = std::clamp(linear, 0.0, 1.0);
  const double s = v <= 0.0031308 ? 12.92 * v : 1.055 * std::pow(v, 1.0 / 2.4) - 0.055;
  return static_cast<uint8_t>(std::lround(255.0 * s));
}

}  // namespace

Image<uint8_t> ToSrgb(ImageView<const float> linear, double white) {
  Image<uint8_t> out(linear.width(), linear.height(), linear.channels());
  const int channels = linear.channels();
  if (!(white > 0.0)) return out;
  const size_t row = static_cast<size_t>(linear.width()) * channels;
  ParallelFor(linear.height(), 16, [&](int64_t begin, int64_t end) {
    for (size_t first = begin * row; first < end * row; first += channels) {
      const std::span<const float> pixel(linear.data() + first, channels);
      // Red and green without the blue would be another colour.
      if (!std::all_of(pixel.begin(), pixel.end(), [](float v) { return std::isfinite(v); })) continue;
      for (int c = 0; c < channels; ++c) out.pixels()[first + c] = SrgbByte(pixel[c] / white);
    }
  });
  return out;
}

Image<uint8_t> WithAlpha(ImageView<const uint8_t> picture, ImageView<const uint8_t> covered) {
  Image<uint8_t> out(picture.width(), picture.height(), picture.channels() + 1);
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x) {
      for (int c = 0; c < picture.channels(); ++c) out(x, y, c) = picture(x, y, c);
      out(x, y, picture.channels()) = covered(x, y) != 0 ? 255 : 0;
    }
  return out;
}

Image<uint8_t> ToColourScale(ImageView<const float> map, double low, double high) {
  Image<uint8_t> out(map.width(), map.height(), 3, 40);
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      const double v = map(x, y);
      if (!std::isfinite(v)) continue;
      const double t = std::clamp((v - low) / std::max(high - low, 1e-12), 0.0, 1.0) * (kScale.size() - 1);
      const size_t i = std::min(static_cast<size_t>(t), kScale.size() - 2);
      const double f = t - static_cast<double>(i);
      for (int c = 0; c < 3; ++c)
        out(x, y, c) = static_cast<uint8_t>(std::lround((1 - f) * kScale[i][c] + f * kScale[i + 1][c]));
    }
  return out;
}

std::string ColourScaleCss() {
  std::string css = "to right";
  for (const auto& rgb : kScale) css += Formatted(",rgb(%d,%d,%d)", int(rgb[0]), int(rgb[1]), int(rgb[2]));
  return css;
}

Image<uint8_t> NormalColours(ImageView<const float> normals) {
  Image<uint8_t> out(normals.width(), normals.height(), 3, 40);
  for (int y = 0; y < normals.height(); ++y)
    for (int x = 0; x < normals.width(); ++x) {
      if (!std::isfinite(normals(x, y, 0))) continue;
      const double n[3] = {normals(x, y, 0), -normals(x, y, 1), -normals(x, y, 2)};
      for (int c = 0; c < 3; ++c)
        out(x, y, c) = static_cast<uint8_t>(std::lround(std::clamp(127.5 * (n[c] + 1.0), 0.0, 255.0)));
    }
  return out;
}

double Percentile(ImageView<const float> map, double fraction) {
  std::vector<float> values;
  for (float v : map.pixels())
    if (std::isfinite(v)) values.push_back(v);
  if (values.empty()) return 0.0;
  const size_t rank = std::min(values.size() - 1, static_cast<size_t>(fraction * static_cast<double>(values.size())));
  std::nth_element(values.begin(), values.begin() + static_cast<int64_t>(rank), values.end());
  return values[rank];
}

}  // namespace stratalux::fit
