// SPDX-License-Identifier: Apache-2.0
// The scatter reading, as in [M]: the radiance beside the line that lies on the pixel, along e in the pixel's tangent
// plane. Light enters at the pixel's column and leaves at the sample, so u = line - sample as in the gather reading.
#include <cmath>

#include "fitter/srd/catmull_rom.h"
#include "fitter/srd/srd_extractor.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

// In single precision, as the image's.
std::array<float, 4> CubicWeights(double f) {
  const auto w = CatmullRomWeights(f);
  return {static_cast<float>(w[0]), static_cast<float>(w[1]), static_cast<float>(w[2]), static_cast<float>(w[3])};
}

// Value of `channel` at (x, y); NaN where a neighbour is unknown or outside.
float Interpolate(ImageView<const float> image, double x, double y, int channel) {
  const int i = static_cast<int>(std::floor(x)), j = static_cast<int>(std::floor(y));
  if (i < 1 || j < 1 || i + 2 >= image.width() || j + 2 >= image.height()) return std::nanf("");
  const auto wx = CubicWeights(x - i), wy = CubicWeights(y - j);
  float sum = 0.0F;
  for (int b = 0; b < 4; ++b)
    for (int a = 0; a < 4; ++a) sum += wx[a] * wy[b] * image(i - 1 + a, j - 1 + b, channel);
  return sum;
}

}  // namespace

void SrdExtractor::Scatter(const CombFrame& frame) {
  const float nan = std::nanf("");
  Image<float> signal(width_, height_, channels_, nan), variance(width_, height_, channels_, nan);
  ParallelFor(height_, 4, [&](int64_t begin, int64_t end) {
    const size_t size = static_cast<size_t>(width_) * static_cast<size_t>(channels_);
    for (int y = static_cast<int>(begin); y < end; ++y) {
      Row row{std::vector<float>(size, nan), std::vector<float>(size, nan)};
      MergeRow(frame, y, row);
      std::copy(row.signal.begin(), row.signal.end(), signal.row(y));
      std::copy(row.variance.begin(), row.variance.end(), variance.row(y));
    }
  });
  const int frames = cycle_.frames();
  ParallelFor(height_, 4, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin * width_ * channels_; i < end * width_ * channels_; ++i) {
      if (!Valid(i)) continue;
      const auto nearest = std::lround((static_cast<double>(column_[i]) - (cycle_.width - 1) * 0.5) / cycle_.step);
      if ((nearest % frames + frames) % frames != frame.k) continue;
      Reject(i, ReadBesideLine(i, signal, variance));
    }
  });
}

SrdReason SrdExtractor::ReadBesideLine(int64_t profile, ImageView<const float> signal,
                                       ImageView<const float> variance) {
  const int c = static_cast<int>(profile % channels_), x = static_cast<int>(profile / channels_ % width_),
            y = static_cast<int>(profile / channels_ / width_);
  const double pitch = QuadStep(rig_.camera.cfa) * options_.pool;
  const Eigen::Vector3d point = surface_.Point(x, y), normal = surface_.Normal(x, y),
                        e = along_[profile].cast<double>();
  const auto home = rig_.camera.model.Project(point);
  if (!home) return SrdReason::kCutOff;
  const float per_white = 1.0F / white_dn_[profile];
  NoiseLine& noise = noise_[profile];
  for (int k = 0; k < batch_.samples; ++k) {
    // u = (line - pixel) - (sample - pixel), so samples come from +e to -e.
    const double along = (batch_.samples / 2 - k) * static_cast<double>(batch_.step_mm[profile]);
    const auto there = rig_.camera.model.Project(point + along * e);
    if (!there) return SrdReason::kCutOff;
    // In the lattice of this colour's own sites, where the pixel itself is (x, y).
    const Eigen::Vector2d at = Eigen::Vector2d(x, y) + (*there - *home) / pitch;
    const int i = static_cast<int>(std::lround(at.x())), j = static_cast<int>(std::lround(at.y()));
    if (!surface_.mask.contains(i, j) || surface_.mask(i, j) == 0) return SrdReason::kCutOff;
    // Another part of the face, in front of this one or behind it.
    if (std::abs(normal.dot(surface_.Point(i, j) - point)) > 1.0 + 0.5 * std::abs(along)) return SrdReason::kCutOff;
    const float value = Interpolate(signal, at.x(), at.y(), c);
    if (!std::isfinite(variance(i, j, c))) return SrdReason::kSaturated;
    if (!std::isfinite(value)) return SrdReason::kCutOff;
    batch_.Samples(profile)[k] = value * per_white;
    noise.Add(value * per_white, variance(i, j, c) * per_white * per_white);
  }
  return SrdReason::kValid;
}

}  // namespace stratalux::fit
