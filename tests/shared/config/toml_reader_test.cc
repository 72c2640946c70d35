// SPDX-License-Identifier: Apache-2.0
#include "shared/config/toml_reader.h"

#include <string>

#include <gmock/gmock.h>

namespace stratalux {
namespace {

using ::testing::HasSubstr;

std::string Dotted(int parts) {
  std::string key = "a";
  for (int i = 1; i < parts; ++i) key += ".a";
  return key;
}

StatusCode CodeOf(const std::string& text) { return TomlTable::ParseText(text, "x.toml").status().code(); }

TEST(TomlTable, AKeyOfAnyNumberOfPartsEndsNoProgram) {
  for (const std::string& text : {Dotted(1'000'000) + " = 1", "[" + Dotted(1'000'000) + "]", "[[" + Dotted(100'000),
                                  "x = [1, {" + Dotted(100'000) + " = 1}]"}) {
    const auto table = TomlTable::ParseText("# first\n" + text + "\n", "x.toml");
    EXPECT_EQ(table.status().code(), StatusCode::kUsage);
    EXPECT_THAT(table.status().message(), HasSubstr("x.toml:2: a key of more than 16 parts"));
  }
  EXPECT_EQ(CodeOf(Dotted(16) + " = 1"), StatusCode::kOk);
  EXPECT_EQ(CodeOf(Dotted(17) + " = 1"), StatusCode::kUsage);
}

TEST(TomlTable, DotsOfTextsCommentsAndNumbersArePartsOfNoKey) {
  const std::string dots(40, '.'), key = Dotted(17) + " = 1";
  EXPECT_EQ(CodeOf("# " + dots + "\na = \"\\\"" + dots + "\"\nb = '" + dots + "'\n\"" + dots + "\" = 1.5\n"),
            StatusCode::kOk);
  EXPECT_EQ(CodeOf("a = \"\"\"\n" + dots + "\n" + dots + "\"\"\"\"\nb = '''" + dots + "''''\n"), StatusCode::kOk);
  EXPECT_EQ(CodeOf("f = [\"../../../../../../../../../../../../../../../../../../a\", 1.5, 2.5]"), StatusCode::kOk);
  // Behind every kind of text a key counts again.
  for (const char* text : {"# x", "a = \"x\\\\\"", "a = 'x\\'", "a = \"\"\"x\"\"\"\"", "a = '''x'''''", "a = \"\""})
    EXPECT_EQ(CodeOf(text + ("\n" + key)), StatusCode::kUsage) << text;
}

}  // namespace
}  // namespace stratalux
