// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/gpio/line_search.h"

namespace stratalux::rig {
namespace {

std::string Labels(std::span<const GpioChip> chips) {
  std::string text;
  for (const GpioChip& chip : chips) text += (text.empty() ? "" : ", ") + chip.label + " (" + chip.path + ")";
  return text.empty() ? "this machine has no GPIO chip that this user may open (group gpio)" : "chips: " + text;
}

}  // namespace

Result<FoundLine> FindLine(std::span<const GpioChip> chips, const LineAddress& address) {
  std::vector<FoundLine> found;
  bool chip_seen = false;
  for (const GpioChip& chip : chips) {
    if (!address.chip.empty() && chip.label != address.chip) continue;
    chip_seen = true;
    if (address.name.empty()) {
      if (address.offset >= 0 && address.offset < static_cast<int>(chip.lines.size()))
        found.push_back({chip.path, static_cast<unsigned>(address.offset)});
      continue;
    }
    for (size_t offset = 0; offset < chip.lines.size(); ++offset)
      if (chip.lines[offset].name == address.name) found.push_back({chip.path, static_cast<unsigned>(offset)});
  }
  const std::string line = "GPIO line " + address.ToString();
  if (found.size() == 1) return found.front();
  if (found.size() > 1)
    return Status::Usage(line + " exists " + std::to_string(found.size()) + " times (" + found[0].chip_path +
                         " offset " + std::to_string(found[0].offset) + ", " + found[1].chip_path + " offset " +
                         std::to_string(found[1].offset) + "); name the chip by its label, the line by its offset");
  if (!chip_seen && !address.chip.empty())
    return Status::NotFound(line + ": no chip has the label '" + address.chip + "'; " + Labels(chips));
  return Status::NotFound(line + " does not exist; " + Labels(chips) + "; `stratalux-rig devices` lists the lines");
}

}  // namespace stratalux::rig
