// SPDX-License-Identifier: Apache-2.0
#include "shared/base/json_number.h"

#include <cstdint>

#include <gtest/gtest.h>

namespace stratalux {
namespace {

using Json = nlohmann::ordered_json;

TEST(WholeNumber, IsTheNumberOrNone) {
  EXPECT_EQ(Whole<int>(Json::parse("-7")), -7);
  EXPECT_EQ(Whole<int>(Json::parse("3.0")), 3);
  EXPECT_EQ(Whole<int64_t>(Json::parse("9223372036854775807")), INT64_MAX);
  EXPECT_EQ(Whole<uint64_t>(Json::parse("18446744073709551615")), UINT64_MAX);
  for (const char* text :
       {"1.5", "1e300", "-1e300", "4294967297", "2147483648", "18446744073709551615", "null", "true", "\"1\"", "[1]"})
    EXPECT_THROW((void)Whole<int>(Json::parse(text)), Json::exception) << text;
  EXPECT_THROW((void)Whole<uint64_t>(Json::parse("-1")), Json::exception);
}

TEST(WholeNumber, NamesItsMember) {
  const Json json = Json::parse(R"({"width": 1e300})");
  EXPECT_EQ(WholeOr<int>(json, "height", 5), 5);
  try {
    (void)WholeAt<int>(json, "width");
    FAIL();
  } catch (const Json::exception& error) {
    EXPECT_NE(std::string(error.what()).find("width: 1e+300 is not a whole number"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace stratalux
