// SPDX-License-Identifier: Apache-2.0
#include "shared/base/json_nesting.h"

#include <cstddef>
#include <string>

namespace stratalux {

Status CheckNesting(std::string_view json) {
  constexpr int kDeepest = 64;
  int depth = 0;
  bool quoted = false;
  for (size_t i = 0; i < json.size(); ++i) {
    const char c = json[i];
    if (quoted) {
      if (c == '\\') ++i;
      quoted = c != '"';
    } else if (c == '"') {
      quoted = true;
    } else if (c == '[' || c == '{') {
      if (++depth > kDeepest) return Status::Integrity("nests deeper than " + std::to_string(kDeepest) + " levels");
    } else if (c == ']' || c == '}') {
      --depth;
    }
  }
  return Status::Ok();
}

}  // namespace stratalux
