// SPDX-License-Identifier: Apache-2.0
// A gpio-sim chip of named lines, made through configfs and driven through sysfs. Needs root and the kernel module
// gpio-sim, loaded (`modprobe gpio-sim`); tests skip without.
#pragma once

#include <memory>
#include <string>
#include <vector>

namespace stratalux::rig {

class GpioSim {
 public:
  // Chip `label` with these lines, by offset. Null where this machine has no gpio-sim.
  static std::unique_ptr<GpioSim> Create(const std::string& label, const std::vector<std::string>& line_names);
  ~GpioSim();
  GpioSim(const GpioSim&) = delete;
  GpioSim& operator=(const GpioSim&) = delete;

  // What the world outside puts on a line.
  void Pull(int offset, bool high);
  // The level that an output drives.
  [[nodiscard]] bool Level(int offset) const;
  // Hot unplug.
  void Unplug();

 private:
  GpioSim() = default;
  std::string config_;  // configfs folder of the device
  std::string lines_;   // sysfs folder of the chip
  size_t line_count_ = 0;
};

}  // namespace stratalux::rig
