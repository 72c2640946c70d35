// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace stratalux {

// The upper one of the two middle values where their number is even; 0 of none.
[[nodiscard]] inline double Median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// The median absolute deviation of a normal distribution, times this, is its standard deviation.
inline constexpr double kMadToDeviation = 1.4826;

}  // namespace stratalux
