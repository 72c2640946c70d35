// SPDX-License-Identifier: Apache-2.0
#include "shared/base/number_ranges.h"

#include <gtest/gtest.h>

namespace stratalux {
namespace {

TEST(NumberRanges, JoinNeighbours) {
  std::vector<NumberRange> ranges;
  EXPECT_EQ(ToText(ranges), "");
  EXPECT_EQ(CountOf(ranges), 0);
  for (const int64_t number : {3, 17, 18, 19, 20, 22}) AppendNumber(ranges, number);
  EXPECT_EQ(ranges, (std::vector<NumberRange>{{3, 3}, {17, 20}, {22, 22}}));
  EXPECT_EQ(CountOf(ranges), 6);
  EXPECT_EQ(ToText(ranges), "3, 17 to 20, 22");
}

TEST(NumberRanges, OfAnyNumberStayALine) {
  std::vector<NumberRange> ranges;
  for (int64_t number = 0; number < 24; number += 2) AppendNumber(ranges, number);
  EXPECT_EQ(ToText(ranges), "0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22");
  for (int64_t number = 24; number < 2'000'000; number += 2) AppendNumber(ranges, number);
  EXPECT_EQ(ToText(ranges), "0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, ...");
  EXPECT_EQ(CountOf(ranges), 1'000'000);
}

TEST(NumberRanges, CountWithoutMakingEachNumber) {
  EXPECT_EQ(CountOf({{0, (int64_t{1} << 62) - 1}}), int64_t{1} << 62) << "a forged header speaks of such frames";
}

}  // namespace
}  // namespace stratalux
