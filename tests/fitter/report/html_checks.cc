// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/report/html_checks.h"

#include <regex>
#include <vector>

namespace stratalux::fit {

std::string FirstBadlyNested(const std::string& html) {
  const std::regex tag("<(/?)([a-z][a-z0-9]*)[^>]*?(/?)>", std::regex::icase);
  std::vector<std::string> open;
  for (std::sregex_iterator it(html.begin(), html.end(), tag), end; it != end; ++it) {
    const std::string name = (*it)[2];
    const bool is_void = name == "meta" || name == "img" || (*it)[3].length() > 0;
    if ((*it)[1].length() > 0) {
      if (open.empty() || open.back() != name) return name;
      open.pop_back();
    } else if (!is_void) {
      open.push_back(name);
    }
  }
  return open.empty() ? "" : open.back();
}

std::string FetchedFromOutside(const std::string& html) {
  for (const char* outside : {"http:", "https:", "<link", "<script", "@import", "url(", "file:"})
    if (html.find(outside) != std::string::npos) return outside;
  return "";
}

}  // namespace stratalux::fit
