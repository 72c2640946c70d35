// SPDX-License-Identifier: Apache-2.0
#include "shared/base/formatted.h"

#include <gtest/gtest.h>

namespace stratalux {
namespace {

TEST(Formatted, WritesAsPrintfDoesWhateverTheLength) {
  EXPECT_EQ(Formatted("%.*f %% of %s, %02d", 1, 12.34, "all", 7), "12.3 % of all, 07");
  EXPECT_EQ(Formatted("%s", ""), "");
  const std::string longer(5000, 'x');
  EXPECT_EQ(Formatted("<%s>", longer.c_str()), "<" + longer + ">");
}

}  // namespace
}  // namespace stratalux
