// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/display_picture.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace stratalux::rig {
namespace {

constexpr double kRefreshTolerance_hz = 0.5;

uint32_t GreyPixel(float intensity, double gamma) {
  const double level = 255.0 * std::pow(std::clamp(static_cast<double>(intensity), 0.0, 1.0), 1.0 / gamma);
  return static_cast<uint32_t>(std::lround(level)) * 0x010101U;
}

}  // namespace

std::optional<size_t> PickMode(std::span<const DisplayMode> modes, int width, int height, double refresh_hz) {
  std::optional<size_t> best;
  for (size_t i = 0; i < modes.size(); ++i) {
    const DisplayMode& mode = modes[i];
    if (mode.width != width || mode.height != height) continue;
    if (refresh_hz == 0.0) {
      if (!best || mode.refresh_hz > modes[*best].refresh_hz) best = i;
      continue;
    }
    const double off = std::abs(mode.refresh_hz - refresh_hz);
    if (off <= kRefreshTolerance_hz && (!best || off < std::abs(modes[*best].refresh_hz - refresh_hz))) best = i;
  }
  return best;
}

void DrawPattern(const Pattern& pattern, double gamma, int width, ImageView<uint32_t> pixels) {
  const int height = pixels.height();
  if (!pattern.IsOneDimensional()) {
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) pixels(x, y) = GreyPixel(pattern.Intensity(x, y), gamma);
    return;
  }
  const bool rows = pattern.axis == PatternAxis::kRows;
  const std::vector<float> profile = pattern.Profile(rows ? height : width);
  std::vector<uint32_t> line(profile.size());
  std::transform(profile.begin(), profile.end(), line.begin(), [&](float i) { return GreyPixel(i, gamma); });
  for (int y = 0; y < height; ++y) {
    if (rows) {
      std::fill_n(pixels.row(y), width, line[y]);
    } else {
      std::copy(line.begin(), line.end(), pixels.row(y));
    }
  }
}

}  // namespace stratalux::rig
