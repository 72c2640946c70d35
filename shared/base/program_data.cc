// SPDX-License-Identifier: Apache-2.0
#include "shared/base/program_data.h"

#include <filesystem>
#include <system_error>

namespace stratalux {

std::vector<std::string> ProgramDataPlaces(const std::string& name) {
  namespace fs = std::filesystem;
  std::vector<std::string> places;
  std::error_code unknown;
  const fs::path program = fs::read_symlink("/proc/self/exe", unknown);
  if (!unknown) places.push_back((program.parent_path().parent_path() / "share" / "stratalux" / name).string());
  const std::string installed = (fs::path(STRATALUX_DATA_FOLDER) / name).string();
  if (places.empty() || places[0] != installed) places.push_back(installed);
  return places;
}

std::string FirstThatIsThere(const std::vector<std::string>& places) {
  for (const std::string& place : places) {
    std::error_code ignored;
    if (std::filesystem::exists(place, ignored)) return place;
  }
  return places.front();
}

}  // namespace stratalux
