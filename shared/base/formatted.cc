// SPDX-License-Identifier: Apache-2.0
#include "shared/base/formatted.h"

#include <algorithm>
#include <cstdarg>
#include <cstdio>

namespace stratalux {

std::string Formatted(const char* format, ...) {
  va_list values, again;
  va_start(values, format);
  va_copy(again, values);
  std::string text(static_cast<size_t>(std::max(std::vsnprintf(nullptr, 0, format, values), 0)), '\0');
  std::vsnprintf(text.data(), text.size() + 1, format, again);
  va_end(again);
  va_end(values);
  return text;
}

}  // namespace stratalux
