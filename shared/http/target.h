// SPDX-License-Identifier: Apache-2.0
// The target of a request line, "/sessions/s%20a?phase=sweep", taken apart.
#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::http {

struct Target {
  std::vector<std::string> segments;  // decoded; none for "/"
  std::map<std::string, std::string> query;
  [[nodiscard]] std::string path() const;
};

// Splits first and decodes then, so that nothing that is decoded can split. kUsage: no absolute path, a percent sign
// without two hex digits, and in the path what could mean another place than it says: "." and ".." segments, empty
// ones (but a last one), slashes, backslashes and control characters that were escaped, bytes that are no UTF-8.
[[nodiscard]] Result<Target> ParseTarget(std::string_view text);

[[nodiscard]] Result<std::string> PercentDecode(std::string_view text);
// For a segment of a path or a value of a query: all but letters, digits and -._~ is escaped.
[[nodiscard]] std::string PercentEncode(std::string_view text);

}  // namespace stratalux::http
