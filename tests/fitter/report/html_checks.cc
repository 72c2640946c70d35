// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/report/html_checks.h"

#include <cctype>
#include <vector>

namespace stratalux::fit {

// By hand: std::regex calls itself for each character of a tag, and a picture's is a megabyte.
std::string FirstBadlyNested(const std::string& html) {
  std::vector<std::string> open;
  for (size_t at = html.find('<'); at != std::string::npos; at = html.find('<', at + 1)) {
    const bool closes = html.compare(at + 1, 1, "/") == 0;
    const size_t first = at + (closes ? 2 : 1), end = html.find('>', first);
    size_t last = first;
    while (last < html.size() && std::isalnum(static_cast<unsigned char>(html[last])) != 0) ++last;
    const std::string name = html.substr(first, last - first);
    if (name.empty()) continue;  // <!DOCTYPE
    if (end == std::string::npos) return name;
    if (closes) {
      if (open.empty() || open.back() != name) return name;
      open.pop_back();
    } else if (name != "meta" && name != "img" && html[end - 1] != '/') {
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
