// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/gpio/gpio_sim.h"

#include <filesystem>
#include <fstream>

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
constexpr const char* kConfig = "/sys/kernel/config/gpio-sim";

bool Write(const std::string& file, const std::string& text) {
  std::ofstream stream(file);
  stream << text << std::flush;
  return stream.good();
}

std::string ReadWord(const std::string& file) {
  std::string word;
  std::ifstream(file) >> word;
  return word;
}

}  // namespace

std::unique_ptr<GpioSim> GpioSim::Create(const std::string& label, const std::vector<std::string>& line_names) {
  std::error_code error;
  if (!fs::is_directory(kConfig, error)) return nullptr;
  std::unique_ptr<GpioSim> sim(new GpioSim);
  sim->config_ = std::string(kConfig) + "/" + label;
  const std::string bank = sim->config_ + "/bank0";
  if (!fs::create_directories(bank, error)) return nullptr;
  bool ok = Write(bank + "/num_lines", std::to_string(line_names.size())) && Write(bank + "/label", label);
  for (size_t i = 0; i < line_names.size(); ++i) {
    const std::string line = bank + "/line" + std::to_string(i);
    ok = ok && fs::create_directory(line, error) && Write(line + "/name", line_names[i]);
  }
  sim->line_count_ = line_names.size();
  if (!ok || !Write(sim->config_ + "/live", "1")) return nullptr;
  sim->lines_ = "/sys/devices/platform/" + ReadWord(sim->config_ + "/dev_name") + "/" + ReadWord(bank + "/chip_name");
  return sim;
}

GpioSim::~GpioSim() {
  Unplug();
  std::error_code ignored;
  for (size_t i = 0; i < line_count_; ++i) fs::remove(config_ + "/bank0/line" + std::to_string(i), ignored);
  fs::remove(config_ + "/bank0", ignored);
  fs::remove(config_, ignored);
}

void GpioSim::Pull(int offset, bool high) {
  Write(lines_ + "/sim_gpio" + std::to_string(offset) + "/pull", high ? "pull-up" : "pull-down");
}

bool GpioSim::Level(int offset) const {
  return ReadWord(lines_ + "/sim_gpio" + std::to_string(offset) + "/value") == "1";
}

void GpioSim::Unplug() { Write(config_ + "/live", "0"); }

}  // namespace stratalux::rig
