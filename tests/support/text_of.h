// SPDX-License-Identifier: Apache-2.0
// What was written to a temporary file, such as a logger's.
#pragma once

#include <cstdio>
#include <string>

namespace stratalux {

[[nodiscard]] inline std::string TextOf(std::FILE* file) {
  std::string text;
  std::rewind(file);
  char buffer[512];
  for (size_t n = 0; (n = std::fread(buffer, 1, sizeof buffer, file)) > 0;) text.append(buffer, n);
  return text;
}

}  // namespace stratalux
