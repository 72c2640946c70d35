// SPDX-License-Identifier: Apache-2.0
// Distances along the measured surface: u_k = integral of m dC from the pixel's column to the line's, along the image
// line that the columns cross, instead of m(x) (c_k - C(x)) on the tangent plane.
#include <algorithm>
#include <cmath>

#include "fitter/srd/catmull_rom.h"
#include "fitter/srd/srd_extractor.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

// Value of the cyclic sequence `y` at the fractional index `at`.
float CyclicCubic(const float* y, int count, double at) {
  const double floor = std::floor(at);
  const auto w = CatmullRomWeights(at - floor);
  const int i = static_cast<int>(floor);
  auto v = [&](int k) { return static_cast<double>(y[((i + k) % count + count) % count]); };
  return static_cast<float>(v(-1) * w[0] + v(0) * w[1] + v(1) * w[2] + v(2) * w[3]);
}

}  // namespace

// Chooses the image axis that the columns mostly run along and adds up m dC over each run of valid profiles on it.
void SrdExtractor::MeasureAlongSurface() {
  const int64_t right = channels_, down = int64_t{width_} * channels_;
  double along_x = 0.0, along_y = 0.0;
  for (int64_t i = 0; i + down < batch_.profiles(); i += channels_) {
    if (!Valid(i)) continue;
    if (Valid(i + right)) along_x += double(column_[i + right]) - column_[i];
    if (Valid(i + down)) along_y += double(column_[i + down]) - column_[i];
  }
  const bool rows = std::abs(along_x) >= std::abs(along_y);
  walk_ = rows ? right : down;
  walk_rises_ = (rows ? along_x : along_y) >= 0.0;
  const int lines = rows ? height_ : width_, length = rows ? width_ : height_;
  const int64_t between = rows ? down : right;
  arc_mm_.assign(column_.size(), 0.0F);
  ParallelFor(lines, 8, [&](int64_t begin, int64_t end) {
    for (int64_t line = begin; line < end; ++line)
      for (int c = 0; c < channels_; ++c)
        for (int t = 1; t < length; ++t) {
          const int64_t i = line * between + t * walk_ + c, before = i - walk_;
          if (!Valid(i) || !Valid(before)) continue;
          const float m = 0.5F * (batch_.step_mm[i] + batch_.step_mm[before]) / static_cast<float>(cycle_.step);
          arc_mm_[i] = arc_mm_[before] + (column_[i] - column_[before]) * m;
        }
  });
}

// Distance from profile `home` to where the surface has column `column`; beyond the end of the surface, as on the
// tangent plane there. `from`: where to begin (home, or where an earlier call for a nearer column ended), moved on.
double SrdExtractor::ArcTo(int64_t home, double column, int64_t& from) const {
  const bool rising = column > column_[home];
  const int64_t stride = rising == walk_rises_ ? walk_ : -walk_;
  const int64_t line = walk_ == channels_ ? int64_t{width_} * channels_ : batch_.profiles();
  auto passed = [&](int64_t i) { return rising ? column_[i] >= column : column_[i] <= column; };
  while (!passed(from)) {
    const int64_t next = from + stride;
    if (next < 0 || next >= batch_.profiles() || next / line != from / line || !Valid(next)) break;
    if (passed(next)) {
      const double share = (column - column_[from]) / (double(column_[next]) - column_[from]);
      return arc_mm_[from] + share * (arc_mm_[next] - arc_mm_[from]) - arc_mm_[home];
    }
    from = next;
  }
  const double m = double(batch_.step_mm[from]) / cycle_.step;
  return arc_mm_[from] - arc_mm_[home] + (column - column_[from]) * m;
}

// Every line carries the same light whatever surface it falls on (irradiance times width is constant), so a sample
// keeps its value and only moves: the cycle is read anew at equal steps of the surface's own length.
void SrdExtractor::ResampleAlongSurface() {
  const int samples = batch_.samples;
  std::vector<float> new_first(batch_.first_u_mm), new_step(batch_.step_mm);
  ParallelFor(batch_.profiles(), 1024, [&](int64_t begin, int64_t end) {
    std::vector<double> u(samples + 1);
    std::vector<float> y(samples);
    for (int64_t i = begin; i < end; ++i) {
      if (!Valid(i)) continue;
      // Samples in the order of their column: number `first` is the leftmost of the period around the pixel.
      const double m = double(batch_.step_mm[i]) / cycle_.step, step = cycle_.step;
      const double offset = double(batch_.first_u_mm[i]) / m;  // columns from the pixel to line 0
      const int first = static_cast<int>(std::ceil((-0.5 * cycle_.period - offset) / step));
      const int left = std::clamp(static_cast<int>(std::ceil((0.0 - offset) / step)) - first, 0, samples);
      int64_t from = i;
      for (int k = left; k <= samples; ++k) u[k] = ArcTo(i, column_[i] + offset + (first + k) * step, from);
      from = i;
      for (int k = left - 1; k >= 0; --k) u[k] = ArcTo(i, column_[i] + offset + (first + k) * step, from);
      const double length = u[samples] - u[0];
      if (!(length > 0.0) || !std::is_sorted(u.begin(), u.end())) continue;  // folded: stays on the tangent plane
      const auto old_y = batch_.Samples(i);
      double before = 0.0, after = 0.0;
      int k = 0;
      for (int j = 0; j < samples; ++j) {
        const double wanted = u[0] + j * length / samples;
        while (k + 1 < samples && u[k + 1] <= wanted) ++k;
        const double at = first + k + (wanted - u[k]) / std::max(u[k + 1] - u[k], 1e-9);
        y[j] = CyclicCubic(old_y.data(), samples, at);
        before += old_y[j];
        after += y[j];
      }
      std::ranges::copy(y, old_y.begin());
      new_first[i] = static_cast<float>(u[0]);
      new_step[i] = static_cast<float>(length / samples);
      if (batch_.white.empty() || !(before > 0.0)) continue;
      const double scale = after / before;  // the white is the sum of the samples, wherever they lie
      batch_.white[i] = static_cast<float>(batch_.white[i] * scale);
      batch_.white_variance[i] = static_cast<float>(batch_.white_variance[i] * scale * scale);
    }
  });
  batch_.first_u_mm = std::move(new_first);
  batch_.step_mm = std::move(new_step);
}

}  // namespace stratalux::fit
