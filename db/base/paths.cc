// SPDX-License-Identifier: Apache-2.0
#include "db/base/paths.h"

#include <algorithm>
#include <string>

namespace stratalux::db {

namespace fs = std::filesystem;

bool StaysInside(const fs::path& name) {
  return !name.empty() && name.is_relative() && name.native().find('\0') == std::string::npos &&
         std::none_of(name.begin(), name.end(), [](const fs::path& part) { return part == ".."; });
}

bool LiesIn(const fs::path& file, const fs::path& folder) {
  std::error_code error;
  // A name that is not there yet stays as it is given, relative ones too.
  const fs::path inside = fs::weakly_canonical(fs::absolute(file, error), error),
                 outside = fs::weakly_canonical(fs::absolute(folder, error), error);
  return std::mismatch(outside.begin(), outside.end(), inside.begin(), inside.end()).first == outside.end();
}

}  // namespace stratalux::db
