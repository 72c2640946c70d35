// SPDX-License-Identifier: Apache-2.0
// Text from anywhere, made fit for a terminal: how wide it is and what must not reach the screen as it is.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace stratalux::db {

// UTF-8 with everything that steers a terminal or hides (control characters, direction marks, bytes that are no UTF-8)
// written out: \n \t \r, \x1b for bytes, \u202e for characters.
[[nodiscard]] std::string Printable(std::string_view text);
// Columns of a terminal that `text` (UTF-8) takes: 0 for combining marks, 2 for East Asian wide characters and emoji.
[[nodiscard]] int DisplayWidth(std::string_view text);
// "1.5 MiB".
[[nodiscard]] std::string SizeText(int64_t bytes);
// The locale (LC_ALL, LC_CTYPE, LANG) says UTF-8.
[[nodiscard]] bool LocaleIsUtf8();

}  // namespace stratalux::db
