// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/preview/frame_figures.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

namespace stratalux::rig {
namespace {

constexpr int kSmallest = 16;

// The value that `share` of the samples stay below or at.
int Quantile(const std::vector<size_t>& counts, size_t total, double share) {
  const auto wanted = static_cast<size_t>(std::ceil(share * static_cast<double>(total)));
  size_t below = 0;
  for (size_t value = 0; value < counts.size(); ++value)
    if ((below += counts[value]) >= wanted) return static_cast<int>(value);
  return 0;
}

void Levels(ImageView<const uint16_t> frame, double saturation_dn, FrameFigures& figures) {
  std::vector<size_t> counts(65536);
  for (int y = 0; y < frame.height(); ++y)
    for (int x = 0; x < frame.width(); ++x) ++counts[frame(x, y)];
  const size_t total = static_cast<size_t>(frame.width()) * static_cast<size_t>(frame.height());
  size_t saturated = 0;
  for (auto value = static_cast<size_t>(std::ceil(saturation_dn)); value < counts.size(); ++value)
    saturated += counts[value];
  figures.level = Quantile(counts, total, 0.5) / saturation_dn;
  figures.bright = Quantile(counts, total, 0.99) / saturation_dn;
  figures.saturated = static_cast<double>(saturated) / static_cast<double>(total);
}

// Quads of the frame's middle half.
Image<float> MiddleQuads(ImageView<const uint16_t> frame) {
  const int left = frame.width() / 4 / 2 * 2, top = frame.height() / 4 / 2 * 2;
  Image<float> quads(frame.width() / 4, frame.height() / 4);
  for (int y = 0; y < quads.height(); ++y)
    for (int x = 0; x < quads.width(); ++x) {
      const int u = left + 2 * x, v = top + 2 * y;
      quads(x, y) = 0.25F * static_cast<float>(frame(u, v) + frame(u + 1, v) + frame(u, v + 1) + frame(u + 1, v + 1));
    }
  return quads;
}

double Focus(const Image<float>& quads) {
  double mean = 0.0, sum = 0.0, squares = 0.0;
  for (int y = 1; y + 1 < quads.height(); ++y)
    for (int x = 1; x + 1 < quads.width(); ++x) {
      const double laplacian =
          double{quads(x - 1, y)} + quads(x + 1, y) + quads(x, y - 1) + quads(x, y + 1) - 4.0 * quads(x, y);
      mean += quads(x, y);
      sum += laplacian;
      squares += laplacian * laplacian;
    }
  const double count = static_cast<double>(quads.width() - 2) * (quads.height() - 2);
  mean /= count;
  if (mean <= 0.0) return 0.0;
  return (squares / count - (sum / count) * (sum / count)) / (mean * mean);
}

}  // namespace

FrameFigures FiguresOf(ImageView<const uint16_t> frame, double saturation_dn) {
  FrameFigures figures;
  if (frame.width() < kSmallest || frame.height() < kSmallest) return figures;
  Levels(frame, saturation_dn, figures);
  figures.focus = Focus(MiddleQuads(frame));
  return figures;
}

}  // namespace stratalux::rig
