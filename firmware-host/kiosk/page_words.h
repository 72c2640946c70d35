// SPDX-License-Identifier: Apache-2.0
// The languages that the kiosk's page speaks: a JSON file each (docs/kiosk-page.md).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::rig {

struct PageLanguage {
  std::string id;    // "de": BCP 47, name of the file
  std::string name;  // as its speakers call it
};

// Reads and checks <id>.json of each: every phase, word and reason of words.h has its text (the word "none" an empty
// one), and all have the keys of the first. kUsage names file and key.
[[nodiscard]] Result<std::vector<PageLanguage>> ReadLanguages(const std::filesystem::path& folder,
                                                              const std::vector<std::string>& ids);

}  // namespace stratalux::rig
