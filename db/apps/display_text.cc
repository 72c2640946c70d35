// SPDX-License-Identifier: Apache-2.0
#include "db/apps/display_text.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>

namespace stratalux::db {
namespace {

struct Decoded {
  char32_t character = 0;
  size_t bytes = 0;  // 0: not UTF-8 here
};

// Strict: no overlong forms, no surrogates, nothing above U+10FFFF (RFC 3629).
Decoded Decode(std::string_view text) {
  const auto byte = [&](size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned lead = byte(0);
  if (lead < 0x80) return {lead, 1};
  const size_t length = lead >= 0xf0 ? 4 : lead >= 0xe0 ? 3 : 2;
  if (lead < 0xc2 || lead > 0xf4 || text.size() < length) return {};
  char32_t character = lead & (0xffU >> (length + 1));
  for (size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xc0U) != 0x80) return {};
    character = (character << 6U) | (byte(i) & 0x3fU);
  }
  constexpr std::array<char32_t, 5> kLeast = {0, 0, 0x80, 0x800, 0x10000};
  if (character < kLeast[length] || character > 0x10ffff || (character >= 0xd800 && character <= 0xdfff)) return {};
  return {character, length};
}

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
// Controls, and what changes the direction or is not seen.
constexpr std::array<Range, 8> kHidden = {{{0x0, 0x1f},
                                           {0x7f, 0x9f},
                                           {0xad, 0xad},
                                           {0x200b, 0x200f},
                                           {0x2028, 0x202e},
                                           {0x2060, 0x2069},
                                           {0xfeff, 0xfeff},
                                           {0xe0000, 0xe007f}}};

std::string Escaped(const char* format, unsigned value) {
  char text[16];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

std::string Shown(char32_t character, std::string_view bytes) {
  if (!Contains(kHidden, character)) return std::string(bytes);
  if (character == '\n') return "\\n";
  if (character == '\t') return "\\t";
  if (character == '\r') return "\\r";
  return Escaped(character < 0x80 ? "\\x%02x" : "\\u%04x", static_cast<unsigned>(character));
}

}  // namespace

std::string Printable(std::string_view text) {
  std::string out;
  while (!text.empty()) {
    const Decoded next = Decode(text);
    const size_t bytes = std::max<size_t>(next.bytes, 1);
    out += next.bytes == 0 ? Escaped("\\x%02x", static_cast<unsigned char>(text[0]))
                           : Shown(next.character, text.substr(0, bytes));
    text.remove_prefix(bytes);
  }
  return out;
}

int DisplayWidth(std::string_view text) {
  int width = 0;
  while (!text.empty()) {
    const Decoded next = Decode(text);
    if (!Contains(kCombining, next.character)) width += Contains(kWide, next.character) ? 2 : 1;
    text.remove_prefix(std::max<size_t>(next.bytes, 1));
  }
  return width;
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
