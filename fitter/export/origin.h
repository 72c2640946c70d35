// SPDX-License-Identifier: Apache-2.0
// Where an exported file comes from, for whoever finds it alone.
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace stratalux::fit {

struct ExportOrigin {
  std::string session = {}, fit = {}, layers = {};  // fit, layers: empty where nothing is fitted yet
  // Those that are known, by name.
  [[nodiscard]] std::vector<std::pair<std::string, std::string>> Named() const {
    std::vector<std::pair<std::string, std::string>> named;
    for (const auto& [name, value] : {std::pair("session", &session), {"fit", &fit}, {"layers", &layers}})
      if (!value->empty()) named.emplace_back(name, *value);
    return named;
  }
};

}  // namespace stratalux::fit
