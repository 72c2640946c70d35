// SPDX-License-Identifier: Apache-2.0
#include "shared/base/printable.h"

#include <gtest/gtest.h>

#include "shared/base/log.h"

namespace stratalux {
namespace {

using std::string_literals::operator""s;

TEST(Printable, WritesOutWhatSteersOrHides) {
  EXPECT_EQ(Printable("\x1b[31m\x07\x7f"), "\\x1b[31m\\x07\\x7f");
  EXPECT_EQ(Printable("a\nb\tc\rd\0e"s), "a\\nb\\tc\\rd\\x00e");
  EXPECT_EQ(Printable("\xc2\x9b\xe2\x80\xae\xef\xbb\xbf"), "\\u009b\\u202e\\ufeff")
      << "CSI of 8 bits, overrides, marks";
  EXPECT_EQ(Printable("\xff\xc0\x80\xed\xa0\x80"), "\\xff\\xc0\\x80\\xed\\xa0\\x80") << "no UTF-8";
  EXPECT_EQ(Printable("Zoë 漢字 \xf0\x9f\x98\x80"), "Zoë 漢字 \xf0\x9f\x98\x80");
  EXPECT_EQ(PrintableLines("a\x1b\nb\r\n"), "a\\x1b\nb\\r\n");
}

TEST(Printable, JsonStaysTheSameValue) {
  EXPECT_EQ(PrintableJson("{\n  \"a\": \"\x7f\xc2\x9b\xe2\x80\xae\xf3\xa0\x81\x81 ë\"\n}"),
            "{\n  \"a\": \"\\u007f\\u009b\\u202e\\udb40\\udc41 ë\"\n}");
}

// RFC 3629: no overlong forms, no surrogates, nothing above U+10FFFF, nothing cut off.
TEST(IsUtf8, IsStrict) {
  for (const char* text : {"", "skin", "H\xc3\xa4ut", "\xe7\x9a\xae\xe8\x86\x9a", "\xf0\x9f\x98\x80"})
    EXPECT_TRUE(IsUtf8(text)) << text;
  for (const char* text : {"gr\xfcn", "\xc3", "\xc0\x80", "\xed\xa0\x80", "\xf4\x90\x80\x80", "\xe0\x80\xaf", "\x80"})
    EXPECT_FALSE(IsUtf8(text)) << Printable(text);
}

TEST(Printable, LogLinesToo) {
  std::FILE* file = std::tmpfile();
  ASSERT_NE(file, nullptr);
  Logger logger(LogLevel::kInfo, file);
  logger.Warning("file \x1b]0;x\x07\nsecond line");
  ASSERT_TRUE(logger.Flush());
  std::rewind(file);
  char text[200] = {};
  const size_t bytes = std::fread(text, 1, sizeof text - 1, file);
  std::fclose(file);
  EXPECT_EQ(std::string(text, bytes), "warning: file \\x1b]0;x\\x07\nsecond line\n");
}

}  // namespace
}  // namespace stratalux
