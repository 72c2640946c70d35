// SPDX-License-Identifier: Apache-2.0
// Names of the colour channels of our EXR files.
#pragma once

#include <string>
#include <vector>

namespace stratalux::fit {

// Y, or R, G, B.
[[nodiscard]] inline std::vector<std::string> Colours(int channels) {
  return channels == 1 ? std::vector<std::string>{"Y"} : std::vector<std::string>{"R", "G", "B"};
}
[[nodiscard]] inline std::vector<std::string> WithColours(const std::string& prefix, int channels) {
  std::vector<std::string> names;
  for (const std::string& colour : Colours(channels)) names.push_back(prefix + colour);
  return names;
}

}  // namespace stratalux::fit
