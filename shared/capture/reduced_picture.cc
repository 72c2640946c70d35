// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/reduced_picture.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace stratalux {
namespace {

// IEC 61966-2-1.
uint8_t ToSrgb(double linear) {
  const double v = std::clamp(linear, 0.0, 1.0);
  const double encoded = v <= 0.0031308 ? 12.92 * v : 1.055 * std::pow(v, 1.0 / 2.4) - 0.055;
  return static_cast<uint8_t>(std::lround(255.0 * encoded));
}

struct Means {
  std::array<double, 3> sum{};
  std::array<int, 3> count{};
};

}  // namespace

Image<uint8_t> ReducedPicture(const FrameRecord& record, ImageView<const uint16_t> frame, int limit_px) {
  const bool mosaic = frame.channels() == 1 && record.cfa != Cfa::kMono;
  const int channels = mosaic || frame.channels() == 3 ? 3 : 1;
  const int longest = std::max(frame.width(), frame.height());
  int block = std::max(1, (longest + limit_px - 1) / limit_px);
  if (mosaic) block += block % 2;  // whole quads, at least one
  const int width = std::max(1, frame.width() / block), height = std::max(1, frame.height() / block);
  const double white = std::exp2(BitDepth(record.format)) - 1.0;
  Image<uint8_t> picture(width, height, channels);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      Means means;
      for (int v = y * block; v < std::min((y + 1) * block, frame.height()); ++v)
        for (int u = x * block; u < std::min((x + 1) * block, frame.width()); ++u)
          for (int c = 0; c < std::min(frame.channels(), 3); ++c) {
            const int colour = mosaic ? CfaColour(record.cfa, u, v) : channels == 1 ? 0 : c;
            means.sum[static_cast<size_t>(colour)] += frame(u, v, c);
            ++means.count[static_cast<size_t>(colour)];
          }
      for (int c = 0; c < channels; ++c) {
        const auto i = static_cast<size_t>(c);
        picture(x, y, c) = ToSrgb(means.count[i] == 0 ? 0.0 : means.sum[i] / means.count[i] / white);
      }
    }
  }
  return picture;
}

}  // namespace stratalux
