// SPDX-License-Identifier: Apache-2.0
#include "shared/base/printable.h"

#include <algorithm>
#include <array>
#include <cstdio>

namespace stratalux {
namespace {

struct Range {
  char32_t first, last;
};
// Controls, and what changes the direction or is not seen.
constexpr std::array<Range, 8> kHidden = {{{0x0, 0x1f},
                                           {0x7f, 0x9f},
                                           {0xad, 0xad},
                                           {0x200b, 0x200f},
                                           {0x2028, 0x202e},
                                           {0x2060, 0x2069},
                                           {0xfeff, 0xfeff},
                                           {0xe0000, 0xe007f}}};

bool IsHidden(char32_t character) {
  return std::any_of(kHidden.begin(), kHidden.end(),
                     [=](const Range& r) { return character >= r.first && character <= r.last; });
}

std::string Escaped(const char* format, unsigned value) {
  char text[16];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

std::string Shown(char32_t character) {
  if (character == '\n') return "\\n";
  if (character == '\t') return "\\t";
  if (character == '\r') return "\\r";
  return Escaped(character < 0x80 ? "\\x%02x" : "\\u%04x", static_cast<unsigned>(character));
}

// UTF-16, as JSON writes what lies beyond U+FFFF.
std::string ShownInJson(char32_t character) {
  if (character <= 0xffff) return Escaped("\\u%04x", static_cast<unsigned>(character));
  const auto rest = static_cast<unsigned>(character) - 0x10000U;
  return Escaped("\\u%04x", 0xd800U + (rest >> 10U)) + Escaped("\\u%04x", 0xdc00U + (rest & 0x3ffU));
}

bool IsPlain(char c) { return c >= 0x20 && c < 0x7f; }

enum class Style { kText, kLines, kJson };

std::string Rewrite(std::string_view text, Style style) {
  std::string out;
  out.reserve(text.size());
  while (!text.empty()) {
    const auto plain = static_cast<size_t>(std::find_if_not(text.begin(), text.end(), IsPlain) - text.begin());
    out += text.substr(0, plain);
    text.remove_prefix(plain);
    if (text.empty()) break;
    const DecodedUtf8 next = DecodeUtf8(text);
    const size_t bytes = std::max<size_t>(next.bytes, 1);
    const bool line_end = next.character == '\n' && style != Style::kText;
    if (next.bytes == 0 && style == Style::kJson) {
      out += "\\ufffd";
    } else if (next.bytes == 0) {
      out += Escaped("\\x%02x", static_cast<unsigned char>(text[0]));
    } else if (line_end || !IsHidden(next.character)) {
      out += text.substr(0, bytes);
    } else {
      out += style == Style::kJson ? ShownInJson(next.character) : Shown(next.character);
    }
    text.remove_prefix(bytes);
  }
  return out;
}

}  // namespace

DecodedUtf8 DecodeUtf8(std::string_view text) {
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

bool IsUtf8(std::string_view text) {
  while (!text.empty()) {
    const size_t bytes = DecodeUtf8(text).bytes;
    if (bytes == 0) return false;
    text.remove_prefix(bytes);
  }
  return true;
}

std::string Printable(std::string_view text) { return Rewrite(text, Style::kText); }
std::string PrintableLines(std::string_view text) { return Rewrite(text, Style::kLines); }
std::string PrintableJson(std::string_view json) { return Rewrite(json, Style::kJson); }

}  // namespace stratalux
