// SPDX-License-Identifier: Apache-2.0
// How the computer under the kiosk is: temperatures, disk.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace stratalux::rig {

struct Temperature {
  std::string name;  // "coretemp Core 0", "cpu-thermal"
  double celsius = 0.0;
};

// Of /sys/class/hwmon (temp*_input with its label) and, where that has none, of /sys/class/thermal; sorted by name.
// What cannot be read, or is no thousandth of a degree within -55 .. 200 degrees, is left out. `sys`: for tests.
[[nodiscard]] std::vector<Temperature> Temperatures(const std::filesystem::path& sys = "/sys");

// That the program's account may still use, bytes, on the disk of the folder or, where it is yet to be made, of the
// nearest one above it; nullopt: the system cannot say.
[[nodiscard]] std::optional<int64_t> FreeBytes(const std::filesystem::path& folder);

}  // namespace stratalux::rig
