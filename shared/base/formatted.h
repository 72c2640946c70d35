// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace stratalux {

// As printf writes it, of any length.
[[gnu::format(printf, 1, 2)]] [[nodiscard]] std::string Formatted(const char* format, ...);

}  // namespace stratalux
