// SPDX-License-Identifier: Apache-2.0
#include "shared/image/box_sums.h"

#include <algorithm>
#include <vector>

#include "shared/base/parallel.h"

namespace stratalux {
namespace {

// `length` groups of `group` values, `stride` apart: each group becomes the sum of those within `radius` of it. `line`,
// `inside`: room to work in.
void Slide(double* first, int length, ptrdiff_t stride, int group, int radius, std::vector<double>& line,
           std::vector<double>& inside) {
  line.resize(static_cast<size_t>(length) * group);
  inside.assign(static_cast<size_t>(group), 0.0);
  for (int k = 0; k < length; ++k) std::copy_n(first + k * stride, group, line.begin() + ptrdiff_t{k} * group);
  const auto add = [&](int k, double sign) {
    for (int c = 0; c < group && k >= 0 && k < length; ++c)
      inside[static_cast<size_t>(c)] += sign * line[static_cast<size_t>(k) * group + c];
  };
  for (int k = 0; k < radius; ++k) add(k, 1.0);
  for (int k = 0; k < length; ++k) {
    add(k + radius, 1.0);
    add(k - radius - 1, -1.0);
    std::copy(inside.begin(), inside.end(), first + k * stride);
  }
}

}  // namespace

Image<double> BoxSums(const Image<double>& values, int radius) {
  SLX_CHECK(radius >= 0);
  Image<double> sums = values;
  const int channels = values.channels();
  const ptrdiff_t row = ptrdiff_t{values.width()} * channels;
  ParallelFor(values.height(), 16, [&](int64_t begin, int64_t end) {
    std::vector<double> line, inside;
    for (int64_t y = begin; y < end; ++y)
      Slide(sums.data() + y * row, values.width(), channels, channels, radius, line, inside);
  });
  // Some columns at a time, which lie side by side in memory.
  ParallelFor(row, 64, [&](int64_t begin, int64_t end) {
    std::vector<double> line, inside;
    Slide(sums.data() + begin, values.height(), row, static_cast<int>(end - begin), radius, line, inside);
  });
  return sums;
}

}  // namespace stratalux
