// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/host_facts.h"

#include <algorithm>
#include <fstream>
#include <system_error>
#include <tuple>

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;

// The kernel's files say nothing of their size, so that ReadFile's question for it would end here.
std::string FirstLine(const fs::path& file) {
  std::string line;
  std::ifstream stream(file);
  std::getline(stream, line);
  return line;
}

std::optional<double> CelsiusOf(const fs::path& file) {
  std::ifstream stream(file);
  double thousandths = 0.0;
  if (!(stream >> thousandths)) return std::nullopt;
  const double celsius = thousandths / 1000.0;
  return celsius < -55.0 || celsius > 200.0 ? std::nullopt : std::optional(celsius);
}

std::vector<fs::path> EntriesOf(const fs::path& folder) {
  std::vector<fs::path> entries;
  std::error_code missing;
  for (fs::directory_iterator at(folder, missing), end; !missing && at != end; at.increment(missing))
    entries.push_back(at->path());
  return entries;
}

void AddHwmon(const fs::path& device, std::vector<Temperature>& all) {
  constexpr const char* kEnding = "_input";
  for (const fs::path& file : EntriesOf(device)) {
    const std::string name = file.filename().string();
    if (!name.starts_with("temp") || !name.ends_with(kEnding)) continue;
    const auto celsius = CelsiusOf(file);
    if (!celsius) continue;
    const std::string channel = name.substr(0, name.size() - std::string(kEnding).size());
    const std::string label = FirstLine(device / (channel + "_label"));
    all.push_back({FirstLine(device / "name") + " " + (label.empty() ? channel : label), *celsius});
  }
}

}  // namespace

std::vector<Temperature> Temperatures(const fs::path& sys) {
  std::vector<Temperature> all;
  for (const fs::path& device : EntriesOf(sys / "class" / "hwmon")) AddHwmon(device, all);
  if (all.empty())
    for (const fs::path& zone : EntriesOf(sys / "class" / "thermal"))
      if (const auto celsius = CelsiusOf(zone / "temp")) all.push_back({FirstLine(zone / "type"), *celsius});
  std::sort(all.begin(), all.end(), [](const Temperature& a, const Temperature& b) {
    return std::tie(a.name, a.celsius) < std::tie(b.name, b.celsius);
  });
  return all;
}

std::optional<int64_t> FreeBytes(const fs::path& folder) {
  std::error_code unknown;
  fs::path there = fs::absolute(folder, unknown);
  while (!fs::exists(there, unknown) && there.has_relative_path()) there = there.parent_path();
  const fs::space_info space = fs::space(there, unknown);
  if (unknown) return std::nullopt;
  return static_cast<int64_t>(space.available);
}

}  // namespace stratalux::rig
