// SPDX-License-Identifier: Apache-2.0
// Numbers that lie in runs, as people are told of them: hundreds in a line.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace stratalux {

struct NumberRange {
  int64_t first = 0, last = 0;  // both belong to it
  [[nodiscard]] int64_t size() const { return last - first + 1; }
  friend bool operator==(const NumberRange&, const NumberRange&) = default;
};

// One number more behind those there: greater than all of them.
void AppendNumber(std::vector<NumberRange>& ranges, int64_t number);

[[nodiscard]] int64_t CountOf(const std::vector<NumberRange>& ranges);

// "3, 17 to 20"; of more than a dozen ranges (a damaged disk may leave every second frame) the first ones and "...".
[[nodiscard]] std::string ToText(const std::vector<NumberRange>& ranges);

}  // namespace stratalux
