// SPDX-License-Identifier: Apache-2.0
#include "shared/base/json_nesting.h"

#include <string>

#include <gtest/gtest.h>

namespace stratalux {
namespace {

std::string Nested(int levels) {
  return std::string(static_cast<size_t>(levels), '[') + std::string(static_cast<size_t>(levels), ']');
}

TEST(CheckNesting, TellsDepthFromWidthAndFromText) {
  EXPECT_TRUE(CheckNesting(Nested(64)).ok());
  EXPECT_EQ(CheckNesting(Nested(65)).code(), StatusCode::kIntegrity);
  EXPECT_EQ(CheckNesting(R"({"a":)" + Nested(64) + "}").code(), StatusCode::kIntegrity);
  std::string wide = "[[]";
  for (int i = 0; i < 1000; ++i) wide += ",[{}]";
  EXPECT_TRUE(CheckNesting(wide + "]").ok());
  EXPECT_TRUE(CheckNesting(R"(["\")" + Nested(100) + R"("])").ok()) << "brackets of a text nest nothing";
  EXPECT_TRUE(CheckNesting(R"("\)").ok());
}

}  // namespace
}  // namespace stratalux
