// SPDX-License-Identifier: Apache-2.0
#include "db/apps/table_output.h"

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/apps/display_text.h"

namespace stratalux::db {
namespace {

using ::testing::ElementsAre;

const std::vector<std::string> kHostile = {
    "",  "plain", "a,b",          "say \"no\"", "two\nlines",   "cr\r\nlf",    " blanks ",
    "-", "=1+1",  "\xff\xfe raw", "Ren\u00e9e", "\u5f20\u4f1f", "\x1b[31mred", std::string("nul\0byte", 8)};

// Fields of RFC 4180 text, written from the RFC and not from the renderer; nullopt is an empty unquoted field.
using Fields = std::vector<std::optional<std::string>>;
std::vector<Fields> ReadCsv(const std::string& text) {
  std::vector<Fields> records(1);
  std::string field;
  bool quoted = false, was_quoted = false;
  const auto end_field = [&] {
    records.back().push_back(field.empty() && !was_quoted ? std::nullopt : std::optional(field));
    field.clear();
    was_quoted = false;
  };
  for (size_t i = 0; i < text.size(); ++i) {
    if (quoted && text[i] == '"' && i + 1 < text.size() && text[i + 1] == '"') {
      field += text[++i];
    } else if (text[i] == '"') {
      quoted = !quoted;
      was_quoted = true;
    } else if (!quoted && text[i] == ',') {
      end_field();
    } else if (!quoted && text[i] == '\r' && i + 1 < text.size() && text[i + 1] == '\n') {
      end_field();
      records.emplace_back();
      ++i;
    } else {
      field += text[i];
    }
  }
  EXPECT_TRUE(records.back().empty()) << "the last record ends with a line break";
  records.pop_back();
  return records;
}

TEST(TableOutput, CsvGivesBackEveryByte) {
  ResultTable table;
  table.columns = {{"na\"me"}, {"number"}};
  for (const std::string& text : kHostile) table.rows.push_back({text, int64_t{-7}});
  table.rows.push_back({std::monostate(), 0.1});
  const auto records = ReadCsv(TableAsCsv(table));
  ASSERT_EQ(records.size(), kHostile.size() + 2);
  EXPECT_EQ(records[0][0], "na\"me");
  for (size_t i = 0; i < kHostile.size(); ++i) {
    EXPECT_EQ(records[i + 1][0], kHostile[i]);
    EXPECT_EQ(records[i + 1][1], "-7");
  }
  EXPECT_EQ(records.back()[0], std::nullopt) << "NULL is not the empty text";
  EXPECT_EQ(records.back()[1], "0.1");
}

TEST(TableOutput, JsonGivesBackTextsAndTypes) {
  ResultTable table;
  table.columns = {{"text"},
                   {"same"},
                   {"same"},
                   {"when", ColumnKind::kWallTime},
                   {"yes", ColumnKind::kBoolean},
                   {"list", ColumnKind::kJson}};
  for (const std::string& text : kHostile)
    table.rows.push_back(
        {text, int64_t{INT64_MIN}, 0.1, int64_t{1'000'000'000}, int64_t{1}, std::string("[1, \"a\"]")});
  table.rows.push_back({Blob{0, 0xab}, std::monostate(), 1e300, std::monostate(), int64_t{0}, std::string("[broken")});
  const auto json = nlohmann::json::parse(TableAsJson(table));
  ASSERT_EQ(json.size(), table.rows.size());
  for (size_t i = 0; i < kHostile.size(); ++i) {
    if (kHostile[i].starts_with('\xff')) {
      EXPECT_EQ(json[i]["text"], "\ufffd\ufffd raw");
    } else {
      EXPECT_EQ(json[i]["text"], kHostile[i]);
    }
    EXPECT_EQ(json[i]["same"], INT64_MIN);
    EXPECT_EQ(json[i]["same_2"], 0.1);
    EXPECT_EQ(json[i]["when"], "1970-01-01T00:00:01Z");
    EXPECT_EQ(json[i]["yes"], true);
    EXPECT_EQ(json[i]["list"], nlohmann::json::parse(R"([1, "a"])"));
  }
  EXPECT_EQ(json.back()["text"], "00ab");
  EXPECT_TRUE(json.back()["same"].is_null());
  EXPECT_EQ(json.back()["same_2"], 1e300);
  EXPECT_EQ(json.back()["list"], "[broken");
}

TEST(TableOutput, NothingSteersTheTerminal) {
  ResultTable table;
  table.columns = {{"a\x1b]0;title\a"}};
  for (const std::string& text : kHostile) table.rows.push_back({text});
  table.rows.push_back({std::string("\u202egnp.exe \u0085 \x7f")});
  const std::string text = TableAsText(table);
  for (const char c : text) EXPECT_TRUE(c == '\n' || static_cast<unsigned char>(c) >= 0x20) << static_cast<int>(c);
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), static_cast<long>(table.rows.size() + 1)) << "a line a row";
  EXPECT_EQ(text.find("\u202e"), std::string::npos);
  EXPECT_NE(text.find("\\u202egnp.exe \\u0085 \\x7f"), std::string::npos);
  EXPECT_NE(text.find("\\x1b[31mred"), std::string::npos);
}

TEST(TableOutput, AlignsByWhatTheTerminalShows) {
  ResultTable table;
  table.columns = {{"name"}, {"n"}, {"hidden", ColumnKind::kPlain, ColumnPlace::kDetail}, {"size", ColumnKind::kBytes}};
  table.rows = {{std::string("\u5f20\u4f1f"), int64_t{5}, int64_t{1}, int64_t{2048}},
                {std::string("Re\u0301ne"), int64_t{500}, int64_t{1}, std::monostate()}};
  EXPECT_EQ(TableAsText(table),
            "name    n     size\n"
            "\u5f20\u4f1f    5  2.0 KiB\n"
            "Re\u0301ne  500        -\n");
  table.rows.clear();
  EXPECT_EQ(TableAsText(table), "name  n  size\n(none)\n");
}

TEST(DisplayText, CountsColumns) {
  EXPECT_EQ(DisplayWidth("abc"), 3);
  EXPECT_EQ(DisplayWidth("\u00e9"), 1);
  EXPECT_EQ(DisplayWidth("e\u0301"), 1);
  EXPECT_EQ(DisplayWidth("\u65e5\u672c"), 4);
  EXPECT_EQ(DisplayWidth("\U0001f600"), 2);
}

TEST(DisplayText, WritesOutWhatIsNoUtf8) {
  EXPECT_EQ(Printable("\xc0\x80 overlong"), "\\xc0\\x80 overlong");
  EXPECT_EQ(Printable("\xed\xa0\x80"), "\\xed\\xa0\\x80") << "a surrogate";
  EXPECT_EQ(Printable("\xf4\x90\x80\x80"), "\\xf4\\x90\\x80\\x80") << "above U+10FFFF";
  EXPECT_EQ(Printable("cut \xe5\xbc"), "cut \\xe5\\xbc");
}

}  // namespace
}  // namespace stratalux::db
