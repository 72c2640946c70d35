// SPDX-License-Identifier: Apache-2.0
// Text from anywhere, made fit for a terminal or a log.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace stratalux {

// UTF-8 with everything that steers a terminal or hides (control characters, direction marks, bytes that are no UTF-8)
// written out: \n \t \r, \x1b for bytes, \u202e for characters.
[[nodiscard]] std::string Printable(std::string_view text);
// The same of each line: line ends stay.
[[nodiscard]] std::string PrintableLines(std::string_view text);
// JSON of the same value, in which such characters are written as \uXXXX: within its texts alone can they stand.
[[nodiscard]] std::string PrintableJson(std::string_view json);

struct DecodedUtf8 {
  char32_t character = 0;
  size_t bytes = 0;  // 0: not UTF-8 here
};
// The first character of `text`, which is not empty. Strict: no overlong forms, no surrogates, nothing above U+10FFFF
// (RFC 3629).
[[nodiscard]] DecodedUtf8 DecodeUtf8(std::string_view text);
[[nodiscard]] bool IsUtf8(std::string_view text);

}  // namespace stratalux
