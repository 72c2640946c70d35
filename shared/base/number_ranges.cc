// SPDX-License-Identifier: Apache-2.0
#include "shared/base/number_ranges.h"

#include <algorithm>

namespace stratalux {

void AppendNumber(std::vector<NumberRange>& ranges, int64_t number) {
  if (!ranges.empty() && ranges.back().last + 1 == number)
    ranges.back().last = number;
  else
    ranges.push_back({number, number});
}

int64_t CountOf(const std::vector<NumberRange>& ranges) {
  int64_t count = 0;
  for (const NumberRange& range : ranges) count += range.size();
  return count;
}

std::string ToText(const std::vector<NumberRange>& ranges) {
  constexpr size_t kMost = 12;
  std::string text;
  for (size_t i = 0; i < std::min(ranges.size(), kMost); ++i) {
    text += (i == 0 ? "" : ", ") + std::to_string(ranges[i].first);
    if (ranges[i].last > ranges[i].first) text += " to " + std::to_string(ranges[i].last);
  }
  return ranges.size() > kMost ? text + ", ..." : text;
}

}  // namespace stratalux
