// SPDX-License-Identifier: Apache-2.0
// Real captures and scans that are no part of the sources: tests that want them are skipped where they are absent.
#pragma once

#include <cstdlib>
#include <filesystem>

namespace stratalux {

// $STRATALUX_DATA, else shared/data beside the sources.
inline std::filesystem::path TestDataFolder() {
  const char* named = std::getenv("STRATALUX_DATA");
  return named != nullptr ? std::filesystem::path(named)
                          : std::filesystem::path(STRATALUX_SOURCE_DIR).parent_path() / "shared" / "data";
}

}  // namespace stratalux
