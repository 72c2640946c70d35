// SPDX-License-Identifier: Apache-2.0
#include "fitter/separation/shrink_noise.h"

#include <algorithm>
#include <cmath>

#include "shared/base/check.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

float Shrunk(const Image<float>& values, const Image<float>& variance, int x, int y, int c, int reach) {
  double sum = 0.0, squares = 0.0, noise = 0.0, count = 0.0;
  for (int j = std::max(y - reach, 0); j <= std::min(y + reach, values.height() - 1); ++j)
    for (int i = std::max(x - reach, 0); i <= std::min(x + reach, values.width() - 1); ++i) {
      const double v = values(i, j, c), n = variance(i, j, c);
      if (!std::isfinite(v) || !std::isfinite(n)) continue;
      sum += v;
      squares += v * v;
      noise += n;
      count += 1.0;
    }
  const bool known = std::isfinite(variance(x, y, c));
  if (count < 2.0) return known ? values(x, y, c) : std::nanf("");
  const double mean = sum / count;
  if (!known) return static_cast<float>(mean);
  const double signal = std::max((squares - sum * mean) / (count - 1.0) - noise / count, 0.0);
  const double all = signal + variance(x, y, c);
  return static_cast<float>(mean + (all > 0.0 ? signal / all : 1.0) * (values(x, y, c) - mean));
}

}  // namespace

Image<float> ShrinkNoise(const Image<float>& values, const Image<float>& variance, int reach) {
  SLX_CHECK(values.size() == variance.size() && values.width() == variance.width() && reach >= 0);
  Image<float> out(values.width(), values.height(), values.channels(), std::nanf(""));
  ParallelFor(values.height(), 16, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < values.width(); ++x)
        for (int c = 0; c < values.channels(); ++c)
          if (std::isfinite(values(x, y, c)) && !std::isnan(variance(x, y, c)))
            out(x, y, c) = Shrunk(values, variance, x, y, c, reach);
  });
  return out;
}

}  // namespace stratalux::fit
