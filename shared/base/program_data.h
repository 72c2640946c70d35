// SPDX-License-Identifier: Apache-2.0
// Files that come with the programs: tables, pages, words.
#pragma once

#include <string>
#include <vector>

namespace stratalux {

// Where `name` ("skin_table.bin", "kiosk/page") may lie: in share/stratalux beside the running program's folder, then
// in the data folder that the build was to be installed in. At least one place.
[[nodiscard]] std::vector<std::string> ProgramDataPlaces(const std::string& name);
// The first of `places` that is there; where none is, the first.
[[nodiscard]] std::string FirstThatIsThere(const std::vector<std::string>& places);

}  // namespace stratalux
