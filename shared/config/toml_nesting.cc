// SPDX-License-Identifier: Apache-2.0
#include "shared/config/toml_nesting.h"

#include <algorithm>
#include <cstddef>
#include <string>

namespace stratalux {
namespace {

constexpr int kMostParts = 16;

// The place behind the string or comment that begins at `at`, or `at` where none does.
size_t Behind(std::string_view text, size_t at) {
  const char quote = text[at];
  if (quote == '#') return std::min(text.find('\n', at), text.size());
  if (quote != '"' && quote != '\'') return at;
  const bool lines = text.substr(at, 3) == std::string(3, quote);
  const std::string end(lines ? 3 : 1, quote);
  for (size_t i = at + end.size(); i < text.size(); ++i) {
    if (quote == '"' && text[i] == '\\') {
      ++i;
    } else if (text.substr(i, end.size()) == end) {
      i += end.size();
      // A string of several lines may end in one or two quotes of its own.
      for (int own = 0; lines && own < 2 && i < text.size() && text[i] == quote; ++own) ++i;
      return i;
    } else if (!lines && text[i] == '\n') {
      return i;  // never closed
    }
  }
  return text.size();
}

}  // namespace

Status CheckKeyParts(std::string_view text) {
  int parts = 1;
  for (size_t i = 0; i < text.size();) {
    if (const size_t next = Behind(text, i); next != i) {
      i = next;
      continue;
    }
    const char c = text[i++];
    if (c == '\n' || c == '=' || c == ',' || c == '{' || c == '[') parts = 1;
    if (c != '.' || ++parts <= kMostParts) continue;
    const auto line = 1 + std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(i), '\n');
    return Status::Usage(std::to_string(line) + ": a key of more than " + std::to_string(kMostParts) + " parts");
  }
  return Status::Ok();
}

}  // namespace stratalux
