// SPDX-License-Identifier: Apache-2.0
#include "db/apps/display_text.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>

namespace stratalux::db {
namespace {

struct Range {
  char32_t first, last;
};

template <size_t N>
bool Contains(const std::array<Range, N>& ranges, char32_t character) {
  return std::any_of(ranges.begin(), ranges.end(),
                     [=](const Range& r) { return character >= r.first && character <= r.last; });
}

// Unicode 15, the blocks that names are written in.
constexpr std::array<Range, 16> kCombining = {{{0x300, 0x36f},
                                               {0x483, 0x489},
                                               {0x591, 0x5bd},
                                               {0x610, 0x61a},
                                               {0x64b, 0x65f},
                                               {0x6d6, 0x6dc},
                                               {0x93c, 0x93c},
                                               {0x941, 0x948},
                                               {0x94d, 0x94d},
                                               {0xe31, 0xe31},
                                               {0xe34, 0xe3a},
                                               {0xe47, 0xe4e},
                                               {0x1ab0, 0x1aff},
                                               {0x1dc0, 0x1dff},
                                               {0x20d0, 0x20ff},
                                               {0xfe00, 0xfe0f}}};
constexpr std::array<Range, 12> kWide = {{{0x1100, 0x115f},
                                          {0x231a, 0x231b},
                                          {0x2e80, 0x303e},
                                          {0x3041, 0x33ff},
                                          {0x3400, 0x4dbf},
                                          {0x4e00, 0x9fff},
                                          {0xa000, 0xa4cf},
                                          {0xac00, 0xd7a3},
                                          {0xf900, 0xfaff},
                                          {0xfe30, 0xfe6f},
                                          {0xff00, 0xff60},
                                          {0x1f300, 0x1faff}}};
}  // namespace

int DisplayWidth(std::string_view text) {
  int width = 0;
  while (!text.empty()) {
    const DecodedUtf8 next = DecodeUtf8(text);
    if (!Contains(kCombining, next.character)) width += Contains(kWide, next.character) ? 2 : 1;
    text.remove_prefix(std::max<size_t>(next.bytes, 1));
  }
  return width;
}

std::string Wrapped(std::string_view text, int columns, const std::string& indent) {
  std::string out;
  int used = 0;
  while (!text.empty()) {
    // A word with the blanks before it; what led to a break is dropped.
    const size_t start = std::min(text.find_first_not_of(' '), text.size());
    const size_t end = std::min(text.find(' ', start), text.size());
    const std::string_view blanks = text.substr(0, start), word = text.substr(start, end - start);
    const int width = DisplayWidth(word);
    if (used > 0 && used + static_cast<int>(blanks.size()) + width > columns) {
      out += "\n" + indent;
      used = 0;
    } else {
      out += blanks;
      used += static_cast<int>(blanks.size());
    }
    out += word;
    used += width;
    text.remove_prefix(end);
  }
  return out;
}

std::string SizeText(int64_t bytes) {
  constexpr std::array<const char*, 5> kUnits = {"B", "KiB", "MiB", "GiB", "TiB"};
  size_t unit = 0;
  auto size = static_cast<double>(bytes);
  for (; size >= 1024.0 && unit + 1 < kUnits.size(); ++unit) size /= 1024.0;
  char text[32];
  std::snprintf(text, sizeof text, unit == 0 ? "%.0f %s" : "%.1f %s", size, kUnits[unit]);
  return text;
}

bool LocaleIsUtf8() {
  for (const char* name : {"LC_ALL", "LC_CTYPE", "LANG"}) {
    const char* value = std::getenv(name);
    if (value == nullptr || *value == '\0') continue;
    std::string locale = value;
    std::transform(locale.begin(), locale.end(), locale.begin(), [](unsigned char c) { return std::toupper(c); });
    return locale.find("UTF-8") != std::string::npos || locale.find("UTF8") != std::string::npos;
  }
  return false;
}

}  // namespace stratalux::db
