// SPDX-License-Identifier: Apache-2.0
// Text for a terminal: how wide it is, how it is broken into lines. What must not reach the screen as it is:
// Printable() of shared/base/printable.h.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "shared/base/printable.h"

namespace stratalux::db {

// Columns of a terminal that `text` (UTF-8) takes: 0 for combining marks, 2 for East Asian wide characters and emoji.
[[nodiscard]] int DisplayWidth(std::string_view text);
// Printable text in lines of at most `columns`, broken at blanks (a word that is longer stands alone); `indent` in
// front of every line but the first.
[[nodiscard]] std::string Wrapped(std::string_view text, int columns, const std::string& indent);
// "1.5 MiB".
[[nodiscard]] std::string SizeText(int64_t bytes);
// The locale (LC_ALL, LC_CTYPE, LANG) says UTF-8.
[[nodiscard]] bool LocaleIsUtf8();

}  // namespace stratalux::db
